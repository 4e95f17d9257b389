// Results: what was measured, from the JSON files of evaluations; each row leads to its films and to the command that makes it again.

import { blob, get } from "./api.js";
import { $, make, shape } from "./draw.js";
import { trouble } from "./main.js";

const FILTERS = ["task", "preset", "loop"];
const HEADS = ["task", "shown", "preset", "loop", "reached", "95 % interval", "median off", "seed", "films"];

let rows = [];
let shown = []; // addresses of the films that are shown

export async function prepare() {
  rows = await get("results");
  const filters = FILTERS.map((name) => {
    const values = [...new Set(rows.map((row) => row[name]).filter(Boolean))].sort();
    return make("label", {}, `${name} `, make("select", { id: `only-${name}`, onchange: fill }, make("option", { value: "" }, "all"), ...values.map((value) => make("option", { value }, value))));
  });
  $("results").replaceChildren(
    make("h1", { id: "results-title" }, "What was measured"),
    make("p", { class: "lead" }, "Goals that were never shown, executed in simulation. A rate alone says little: the bar spans its 95 % interval."),
    make("div", { class: "row" }, ...filters, make("output", { id: "result-count", class: "note" })),
    make("div", { class: "table" }, make("table", {}, make("thead", {}, make("tr", {}, ...HEADS.map((head) => make("th", { scope: "col" }, head)))), make("tbody", { id: "result-rows" }))),
    make("div", { class: "command", id: "result-chosen", hidden: true, tabindex: "-1" }, make("h2", { id: "result-name" }), make("h3", {}, "Once more, on the command line"), make("code", { id: "result-command" }), make("div", { class: "result-films", id: "result-films" })),
  );
  fill();
}

function fill() {
  const chosen = rows.filter((row) => FILTERS.every((name) => !$(`only-${name}`).value || row[name] === $(`only-${name}`).value));
  $("result-rows").replaceChildren(...chosen.map(tableRow));
  $("result-count").textContent = `${chosen.length} of ${rows.length}`;
}

/** The command and the films of a row. */
async function choose(row) {
  $("result-name").textContent = row.name;
  $("result-command").textContent = row.command ?? `${row.name}.json does not say which command made it`;
  $("result-chosen").hidden = false;
  $("result-chosen").focus();
  shown.forEach(URL.revokeObjectURL);
  shown = [];
  $("result-films").replaceChildren();
  for (const film of row.films) {
    const src = URL.createObjectURL(await blob(`results/${encodeURIComponent(row.name)}/films/${encodeURIComponent(film)}`));
    shown.push(src);
    $("result-films").append(make("figure", {}, make("video", { src, controls: true, loop: true, muted: true, playsinline: true, "aria-label": `film ${film}` }), make("figcaption", {}, film)));
  }
}

function interval({ interval: bounds, success, goals }) {
  const [low, high] = bounds.map((bound) => 100 * bound);
  const bar = shape("svg", { viewBox: "0 0 100 10", class: "interval", role: "img", "aria-label": `${low.toFixed(0)} to ${high.toFixed(0)} %` });
  bar.append(shape("rect", { x: 0, y: 2, width: 100, height: 6, rx: 3, class: "all" }), shape("rect", { x: low, y: 2, width: Math.max(1, high - low), height: 6, rx: 3, class: "span" }), shape("circle", { cx: (100 * success) / goals, cy: 5, r: 4, class: "best" }));
  return bar;
}

function tableRow(row) {
  const show = make("button", { type: "button", class: "link", "aria-label": `${row.task}: command and films of ${row.name}`, onclick: () => choose(row).catch(trouble) }, row.task);
  const cells = [row.num_demonstrations ?? "", row.preset, row.loop, `${row.success}/${row.goals}`, interval(row), row.deviation_cm == null ? "" : `${row.deviation_cm.toFixed(1)} cm`, row.seed ?? "", row.films.length || ""];
  return make("tr", {}, make("th", { scope: "row" }, show), ...cells.map((cell, column) => make("td", { "data-head": HEADS[column + 1] }, typeof cell === "number" ? `${cell}` : cell)));
}
