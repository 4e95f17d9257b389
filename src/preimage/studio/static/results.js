// Results: what was measured, from the JSON files of evaluations.

import { get } from "./api.js";
import { $, make } from "./draw.js";

const FILTERS = ["task", "preset", "loop"];
const HEADS = ["task", "shown", "preset", "loop", "reached", "95 % interval", "median off", "seed"];

let rows = [];

export async function prepare() {
  rows = await get("results");
  const filters = FILTERS.map((name) => {
    const values = [...new Set(rows.map((row) => row[name] ?? "full"))].sort();
    return make("label", {}, `${name} `, make("select", { id: `only-${name}`, onchange: fill }, make("option", { value: "" }, "all"), ...values.map((value) => make("option", { value }, value))));
  });
  $("results").replaceChildren(
    make("h1", { id: "results-title" }, "What was measured"),
    make("p", { class: "lead" }, "Goals that were never shown, executed in simulation. A rate alone says little: the bar spans its 95 % interval."),
    make("div", { class: "row" }, ...filters),
    make("div", { class: "table" }, make("table", {}, make("thead", {}, make("tr", {}, ...HEADS.map((head) => make("th", { scope: "col" }, head)))), make("tbody", { id: "result-rows" }))),
    make("div", { class: "command" }, make("h3", {}, "The command of the chosen row"), make("code", { id: "result-command", role: "status" }, "choose a row")),
  );
  fill();
}

function fill() {
  const chosen = rows.filter((row) => FILTERS.every((name) => !$(`only-${name}`).value || (row[name] ?? "full") === $(`only-${name}`).value));
  $("result-rows").replaceChildren(...chosen.map(tableRow));
}

function tableRow(row) {
  const [low, high] = row.interval.map((bound) => 100 * bound);
  const bar = document.createElementNS("http://www.w3.org/2000/svg", "svg");
  bar.setAttribute("viewBox", "0 0 100 10");
  bar.setAttribute("class", "interval");
  bar.setAttribute("aria-hidden", "true");
  const part = (name, about) => {
    const element = document.createElementNS("http://www.w3.org/2000/svg", name);
    for (const [key, value] of Object.entries(about)) element.setAttribute(key, value);
    return element;
  };
  bar.append(part("rect", { x: 0, y: 2, width: 100, height: 6, rx: 3, class: "all" }), part("rect", { x: low, y: 2, width: Math.max(1, high - low), height: 6, rx: 3, class: "span" }), part("circle", { cx: (100 * row.success) / row.goals, cy: 5, r: 4, class: "best" }));
  const show = make("button", { type: "button", class: "link", onclick: () => ($("result-command").textContent = row.command ?? `${row.name}.json does not say which command made it`) }, row.task);
  const cells = [row.num_demonstrations ?? "", row.preset ?? "full", row.loop ?? "", `${row.success}/${row.goals}`, bar, row.deviation_cm == null ? "" : `${row.deviation_cm.toFixed(1)} cm`, row.seed ?? ""];
  return make("tr", {}, make("th", { scope: "row" }, show), ...cells.map((cell, column) => make("td", { "data-head": HEADS[column + 1] }, typeof cell === "number" ? `${cell}` : cell)));
}
