// Demonstrations: every episode, its film locked to its joint curves, and what the examination found.

import { get } from "./api.js";
import { $, Film, chart, line, make, scale, shape } from "./draw.js";
import { trouble } from "./main.js";

let studio;
let shown = null;
let film = null;
let step = 0;
const flagged = new Map();
let charts = [];

export async function prepare(opened) {
  studio = opened;
  const data = make("select", { id: "data", onchange: () => pickData().catch(trouble) }, ...studio.data.map(({ name }) => make("option", {}, name)));
  $("demonstrations").replaceChildren(
    make("h1", { id: "demonstrations-title" }, "What it was shown"),
    make("p", { class: "row" }, make("label", {}, "Data set ", data)),
    make("p", { class: "lead", id: "data-verdict", role: "status" }, ""),
    make(
      "div",
      { class: "hero" },
      make(
        "div",
        {},
        make("canvas", { id: "episode-film", class: "wide", width: 64, height: 64, role: "img", "aria-label": "The film of the episode" }),
        make("div", { class: "player" }, make("label", { class: "head" }, make("span", { class: "unseen" }, "Step"), make("input", { type: "range", id: "episode-head", min: 0, value: 0, oninput: (event) => go(Number(event.target.value)) })), make("output", { id: "episode-words" }, "")),
        make("div", { class: "joints", id: "episode-joints" }),
      ),
      make("div", {}, make("h2", {}, "Episodes"), make("div", { class: "episodes", id: "episodes" }), make("div", { class: "command", id: "left-out", hidden: true }, make("h3", {}, "Train without the flagged ones"), make("code", { id: "left-out-command" })), make("h2", {}, "What the examination found"), make("ul", { class: "findings", id: "findings" })),
    ),
  );
  await pickData();
}

const name = () => $("data").value;

async function pickData() {
  const { episodes } = studio.data.find((each) => each.name === name());
  const row = (number) => {
    const flag = make("input", { type: "checkbox", "aria-label": `flag episode ${number}`, onchange: (event) => leaveOut(number, event.target.checked) });
    flag.checked = flagged.get(name())?.has(number) ?? false;
    return make("div", { class: "row" }, make("button", { type: "button", "data-episode": number, onclick: () => pick(number).catch(trouble) }, `episode ${number}`), make("label", {}, flag, " flag"));
  };
  $("episodes").replaceChildren(...episodes.map(row));
  leaveOut(null);
  await pick(episodes[0]);
  $("data-verdict").textContent = "Looking through every frame …";
  $("findings").replaceChildren();
  const { verdict, findings } = await get(`data/${encodeURIComponent(name())}/findings`);
  $("data-verdict").textContent = verdict;
  $("findings").replaceChildren(
    ...findings.map(({ severity, kind, what, help, places }) => {
      const jumps = places.slice(0, 5).map(([episode, at]) => make("button", { type: "button", class: "small", onclick: () => pick(episode, at).catch(trouble) }, `episode ${episode}, step ${at}`));
      return make("li", { class: severity }, make("b", {}, `${kind}: `), `${what}${help ? `; ${help}` : ""} `, ...jumps);
    }),
  );
}

async function pick(episode, at = 0) {
  shown = await get(`data/${encodeURIComponent(name())}/episodes/${episode}`);
  film = await Film.of(shown.film, shown.height);
  $("episode-head").max = film.steps - 1;
  for (const button of document.querySelectorAll("#episodes button")) button.setAttribute("aria-pressed", `${Number(button.dataset.episode) === episode}`);
  charts = shown.joint_names.map((joint) => shape("svg", { role: "img", "aria-label": `joint ${joint}` }));
  $("episode-joints").replaceChildren(...shown.joint_names.map((joint, index) => make("figure", {}, make("figcaption", {}, joint), charts[index])));
  const nearest = shown.steps.findIndex((each) => each >= at);
  go(Math.max(0, nearest));
}

function go(to) {
  step = to;
  film.draw($("episode-film"), step);
  $("episode-head").value = step;
  const told = `episode ${shown.episode}, step ${shown.steps[step]} of ${shown.steps.at(-1)}`;
  $("episode-words").textContent = told;
  $("episode-head").setAttribute("aria-valuetext", told);
  charts.forEach((svg, joint) => chart(svg, (width, height) => drawJoint(joint, width, height)));
}

function drawJoint(joint, width, height) {
  const values = shown.joints.map((row) => row[joint]);
  const x = scale(0, values.length - 1, 4, width - 4);
  const y = scale(Math.min(...values), Math.max(...values), height - 6, 6);
  return [line([[x(step), 0], [x(step), height]], { class: "playhead" }), line(values.map((value, at) => [x(at), y(value)]), { class: "imagined" }), shape("circle", { cx: x(step), cy: y(values[step]), r: 3.5, class: "best" })];
}

function leaveOut(number, is) {
  const numbers = flagged.get(name()) ?? new Set();
  if (number != null) is ? numbers.add(number) : numbers.delete(number);
  flagged.set(name(), numbers);
  $("left-out").hidden = !numbers.size;
  $("left-out-command").textContent = `preimage train ${studio.data.find((each) => each.name === name()).folder} --without-episodes ${[...numbers].sort((a, b) => a - b).join(" ")} --out runs/new`;
}
