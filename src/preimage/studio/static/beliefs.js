// What is believed, step by step: how far what is sensed and what is wanted are from what is imagined, and what happened.

import { $, chart, line, make, scale, shape, words } from "./draw.js";

const LEAST = 1e-4; // share below which an error counts as none
const TICKS = [0.001, 0.01, 0.1, 1];
const KINDS = [["doubt", "sensed, not as imagined"], ["unexplained", "goal, not as imagined"]];

let beliefs = [];
let limit; // of doubt, above which the arm is held after a few steps

export function beliefsPanel(disbelief) {
  limit = disbelief;
  const legend = KINDS.map(([name, label]) => make("span", {}, make("i", { class: name }), ` ${label} `, make("output", { id: `belief-${name}` })));
  const fact = (id, label) => make("div", {}, make("dt", {}, label), make("dd", { id }, "–"));
  return [
    make("dl", { class: "facts" }, fact("belief-arrival", "arrival"), fact("belief-goal", "error, goal"), fact("belief-window", "error, window"), fact("belief-thought", "thought")),
    make("figure", { class: "curve" }, make("figcaption", { class: "legend" }, ...legend), shape("svg", { id: "beliefs", role: "img", "aria-label": "Doubt and the goal's error, step by step, as shares of the error of staying at the start" })),
    make("ol", { class: "happened", id: "happened", "aria-label": "What happened", "aria-live": "polite" }),
  ];
}

export function clearBeliefs() {
  beliefs = [];
  delete $("beliefs").dataset.step;
  $("happened").replaceChildren();
  for (const id of ["belief-arrival", "belief-goal", "belief-window", "belief-thought"]) $(id).textContent = "–";
  for (const [name] of KINDS) $(`belief-${name}`).textContent = "";
  chart($("beliefs"), draw);
}

export function believe(belief) {
  beliefs.push(belief);
  $("beliefs").dataset.step = belief.step;
  const percent = (share) => `${(100 * share).toPrecision(2)} %`;
  $("belief-arrival").textContent = `step ${belief.step + belief.steps_left}`;
  $("belief-goal").textContent = belief.goal_error.toPrecision(3);
  $("belief-window").textContent = belief.window_error.toPrecision(3);
  $("belief-thought").textContent = `${Math.round(1000 * belief.seconds)} ms, ${belief.num_imagined === 1 ? "1 future" : `${belief.num_imagined} futures`}`;
  for (const [name] of KINDS) $(`belief-${name}`).textContent = percent(belief[name]);
  const told = [...belief.happened, ...(belief.moved ? ["it sees that a thing was moved"] : [])];
  $("happened").append(...told.map((what) => make("li", {}, make("b", {}, `step ${belief.step} `), what)));
  chart($("beliefs"), draw);
}

function draw(width, height) {
  const [left, right, top, bottom] = [54, 10, 8, 20];
  const x = scale(0, Math.max(8, beliefs.length - 1), left + 6, width - right);
  const y = (share) => scale(Math.log(LEAST), Math.log(1.5), height - bottom, top)(Math.log(Math.min(1.5, Math.max(LEAST, share))));
  const grid = TICKS.flatMap((tick) => [line([[left, y(tick)], [width - right, y(tick)]], { class: "grid" }), words(`${100 * tick} %`, left - 6, y(tick) + 4, { class: "tick end" })]);
  const curves = KINDS.flatMap(([name]) => {
    const points = beliefs.map((belief, step) => [x(step), y(belief[name])]);
    return points.length ? [line(points, { class: name }), shape("circle", { cx: points.at(-1)[0], cy: points.at(-1)[1], r: 4, class: `end-${name}` })] : [];
  });
  const marks = beliefs.map((belief, step) => belief.happened.length > 0 && line([[x(step), top], [x(step), height - bottom]], { class: "playhead" }));
  const held = line([[left, y(limit)], [width - right, y(limit)]], { class: "limit" });
  return [...grid, held, ...marks, ...curves, words(beliefs.length ? `step ${beliefs.at(-1).step}` : "falls and rises here, step by step", width - right, height - 4, { class: "tick end" })];
}
