// Training: the errors of runs as they fall, read from their logs.

import { get } from "./api.js";
import { $, chart, line, make, scale, seconds, words } from "./draw.js";
import { trouble } from "./main.js";

const AGAIN_MS = 2000;

let timer = null;

export async function prepare() {
  $("training").replaceChildren(make("h1", { id: "training-title" }, "Trainings"), make("p", { class: "lead" }, "Errors of both modalities, update by update, read from the logs of the run folders while they grow."), make("div", { id: "runs" }));
}

export async function enter() {
  const runs = await get("runs");
  const there = new Set([...$("runs").children].map((card) => card.dataset.name));
  if (runs.length !== there.size || runs.some(({ name }) => !there.has(name))) $("runs").replaceChildren(...runs.map(card));
  runs.forEach(update);
  clearTimeout(timer);
  timer = setTimeout(() => !$("training").hidden && enter().catch(trouble), AGAIN_MS);
}

export function leave() {
  clearTimeout(timer);
}

function card({ name }) {
  const plots = ["vision", "joints"].map((modality) => make("figure", {}, make("figcaption", { class: "row between" }, make("span", {}, modality), make("output", { "data-modality": modality })), document.createElementNS("http://www.w3.org/2000/svg", "svg")));
  return make("article", { class: "training", "data-name": name }, make("h2", {}, name), make("p", { class: "hint progress" }), make("div", { class: "pair" }, ...plots));
}

function update(run) {
  const article = [...$("runs").children].find((each) => each.dataset.name === run.name);
  const left = run.left_s ? `, ${seconds(run.left_s)} left` : "";
  article.querySelector(".progress").textContent = `update ${run.done} of ${run.updates ?? "?"}${left}`;
  const [vision, joints] = article.querySelectorAll("svg");
  for (const [svg, values, name] of [[vision, run.visual, "vision"], [joints, run.proprioceptive, "joints"]]) {
    svg.setAttribute("role", "img");
    svg.setAttribute("aria-label", `error of ${name}, update by update`);
    article.querySelector(`output[data-modality=${name}]`).textContent = values.length ? values.at(-1).toPrecision(3) : "";
    chart(svg, (width, height) => drawErrors(run.update, values, run.updates, width, height));
  }
}

function drawErrors(updates, values, most, width, height) {
  const shown = values.filter((value) => value > 0);
  if (!shown.length) return [words("no update yet", 8, height / 2, { class: "quiet" })];
  const [low, high] = [Math.log(Math.min(...shown)), Math.log(Math.max(...shown))];
  const x = scale(1, most ?? updates.at(-1), 4, width - 4);
  const y = scale(low, high, height - 6, 6);
  return [line([[4, height - 2], [width - 4, height - 2]], { class: "axis" }), line(values.map((value, index) => [x(updates[index]), y(Math.log(Math.max(value, 1e-9)))]), { class: "imagined thin" })];
}
