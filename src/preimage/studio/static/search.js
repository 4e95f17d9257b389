// The search as it goes on: the error falling evaluation by evaluation, and the candidates racing for their arrival steps.

import { $, chart, line, scale, shape, words } from "./draw.js";
import { state } from "./state.js";

const TICKS = [0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200];

export function drawSearch() {
  const best = bestSeen();
  $("error-now").textContent = best ? best.error.toPrecision(3) : "";
  $("arriving-words").textContent = best ? `imagined arrival, step ${best.arrival}` : "imagined arrival";
  chart($("errors"), drawErrors);
  chart($("arrivals"), drawArrivals);
}

/** The evaluation with the lowest error so far, whose arrival is shown: it alone came with a picture. */
const bestSeen = () => state.seen.findLast(({ frame }) => frame);

/** The way of the last search in the plane of intentions, best point by best point. */
export function searchPath() {
  let lowest = Infinity;
  return state.seen.filter(({ error }) => error < lowest && ((lowest = error), true)).map(({ point }) => point);
}

function drawErrors(width, height) {
  const { seen } = state;
  const [left, right, top, bottom] = [38, 8, 10, 20];
  const frame = line([[left, height - bottom], [width - right, height - bottom]], { class: "axis" });
  if (!seen.length) return [frame, words("falls here, evaluation by evaluation", left + 8, height / 2, { class: "quiet" })];
  const all = seen.flatMap(({ errors }) => errors);
  const low = Math.min(...all) * 0.8;
  const high = Math.max(Math.min(Math.max(...all), seen[0].lowest * 30), low * 4);
  const x = scale(1, Math.max(seen.length, 4), left + 8, width - right - 6);
  const y = (value) => scale(Math.log(low), Math.log(high), height - bottom - 4, top)(Math.log(Math.min(value, high)));
  const ticks = TICKS.filter((tick) => tick > low && tick < high).slice(-4);
  const grid = ticks.flatMap((tick) => [line([[left, y(tick)], [width - right, y(tick)]], { class: "grid" }), words(`${tick}`, left - 6, y(tick) + 4, { class: "tick end" })]);
  const dots = seen.flatMap(({ n, errors }) => errors.map((error) => shape("circle", { cx: x(n), cy: y(error), r: 2.2, class: "dot" })));
  const lowest = seen.map(({ n, lowest: error }) => [x(n), y(error)]);
  const end = lowest.at(-1);
  return [
    ...grid, frame, ...dots, line(lowest, { class: "lowest" }), shape("circle", { cx: end[0], cy: end[1], r: 5, class: "best" }),
    words("1", left + 8, height - 4, { class: "tick middle" }), words(seen.length > 1 ? `${seen.length} evaluations` : "1 evaluation", width - right, height - 4, { class: "tick end" }),
  ];
}

function drawArrivals(width, height) {
  const best = bestSeen();
  const steps = state.found?.steps ?? 16;
  const x = scale(0, steps - 1, 14, width - 14);
  const y = height / 2 - 6;
  const marks = Array.from({ length: steps }, (_, step) => shape("circle", { cx: x(step), cy: y, r: 1.6, class: "tickmark" }));
  const base = [line([[14, y], [width - 14, y]], { class: "axis" }), ...marks, (!best || x(best.arrival) > 120) && words("start", 8, height - 3, { class: "tick" }), (!best || x(best.arrival) < width - 140) && words("horizon", width - 8, height - 3, { class: "tick end" })];
  if (!best) return base;
  const others = state.seen.at(-1).arrivals.map((step) => shape("circle", { cx: x(step), cy: y, r: 4, class: "dot" }));
  return [...base, ...others, shape("circle", { cx: x(best.arrival), cy: y, r: 7, class: "best" }), words(`arrives at step ${best.arrival}`, Math.min(Math.max(x(best.arrival), 66), width - 66), height - 3, { class: "tick middle strong" })];
}
