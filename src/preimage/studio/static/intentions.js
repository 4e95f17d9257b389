// Intentions: where the training sequences lie, and what is imagined from any point between them.

import { get, post } from "./api.js";
import { $, Film, chart, line, make, scale, shape, still } from "./draw.js";
import { trouble } from "./main.js";
import { searchPath } from "./search.js";

const EDGE = 0.35; // standard deviations around the outermost intentions
const KEY_STEP = 0.1; // standard deviations that an arrow key moves the point by
const FRAME_MS = 160;

let studio;
let map;
let ends;
let film = null;
let step = 0;
let timer = null;
let point = [0, 0];
let colour = 0;
let near = null;
let asking = false;
let wanted = null;
let toPlane = null;
let svg;

export async function prepare(opened) {
  studio = opened;
  const section = $("intentions");
  section.replaceChildren(make("h1", { id: "intentions-title" }, "Where intentions lie"), make("p", { class: "lead", role: "status" }, "Imagining from every training intention …"));
  map = await get("intentions");
  ends = await Film.of(map.ends, map.height);
  build(section);
  await imagine();
}

export function enter() {
  if (map) chart(svg, draw);
  if (film && !still.matches) play();
}

export function leave() {
  clearTimeout(timer);
}

function build(section) {
  svg = shape("svg", { id: "plane", tabindex: "0", role: "application", "aria-label": "Plane of intentions: arrow keys move the point, what is imagined from it follows" });
  const colours = make("select", { onchange: (event) => ((colour = event.target.selectedIndex), chart(svg, draw)) }, ...map.colours.map(({ name }) => make("option", {}, name)));
  section.replaceChildren(
    make("h1", { id: "intentions-title" }, "Where intentions lie"),
    make("p", { class: "lead" }, "Each dot is a training sequence. Nobody told the network where a goal is: alike sequences became neighbours. Drag the point, and what it imagines follows."),
    make(
      "div",
      { class: "hero" },
      make("figure", { class: "plane" }, svg, make("figcaption", { class: "row between" }, make("label", {}, "Colour ", colours), make("span", { class: "scale", id: "colour-scale" }))),
      make(
        "div",
        { class: "search" },
        make("figure", {}, make("canvas", { id: "intention-film", width: 64, height: 64, role: "img", "aria-label": "The film imagined from the point" }), make("figcaption", {}, make("output", { id: "intention-words" }))),
        make("div", { class: "row aside" }, make("canvas", { id: "intention-end", width: 64, height: 64, role: "img", "aria-label": "How the sequence next to the pointer ends" }), make("p", { class: "hint", id: "end-words" }, "The nearest training sequence ends like this.")),
      ),
    ),
  );
  svg.addEventListener("pointerdown", (event) => (svg.setPointerCapture(event.pointerId), moveTo(event)));
  svg.addEventListener("pointermove", (event) => (event.buttons ? moveTo(event) : hover(placeOf(event))));
  svg.addEventListener("keydown", (event) => {
    const by = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
    if (!by) return;
    event.preventDefault();
    set(point.map((value, axis) => value + by[axis] * KEY_STEP));
  });
}

function placeOf(event) {
  const box = svg.getBoundingClientRect();
  return toPlane(event.clientX - box.left, event.clientY - box.top);
}

const moveTo = (event) => set(placeOf(event));

function set(place) {
  point = place.map((value) => Math.max(-6, Math.min(6, value)));
  hover(point);
  imagine().catch(trouble);
}

/** Ask for the film of the point, one question at a time: where it moved on meanwhile, the last place is asked for next. */
async function imagine() {
  wanted = [...point];
  if (asking) return;
  asking = true;
  try {
    while (wanted) {
      const now = wanted;
      wanted = null;
      const told = await post("intentions/film", { point: now });
      film = await Film.of(told.film, told.height);
      $("intention-words").textContent = `imagined from ${now.map((value) => value.toFixed(1)).join(", ")} (standard deviations)`;
      film.draw($("intention-film"), still.matches ? film.steps - 1 : Math.min(step, film.steps - 1));
    }
    if (!still.matches) play();
  } finally {
    asking = false;
  }
  hover(point);
}

function play() {
  clearTimeout(timer);
  const advance = () => {
    step = (step + 1) % (film.steps + 3); // the end stays a little
    film.draw($("intention-film"), step);
    timer = setTimeout(advance, FRAME_MS);
  };
  timer = setTimeout(advance, FRAME_MS);
}

function hover(place) {
  const away = map.points.map((other) => Math.hypot(other[0] - place[0], other[1] - place[1]));
  near = away.indexOf(Math.min(...away));
  ends.draw($("intention-end"), near);
  $("end-words").textContent = `From the training intention nearest to the pointer, number ${near}, it imagines to end like this.`;
  chart(svg, draw);
}

function draw(width, height) {
  const [xs, ys] = [0, 1].map((axis) => map.points.map((place) => place[axis]).concat(searchPath().map((place) => place[axis])));
  const [lowX, highX, lowY, highY] = [Math.min(...xs) - EDGE, Math.max(...xs) + EDGE, Math.min(...ys) - EDGE, Math.max(...ys) + EDGE];
  const x = scale(lowX, highX, 0, width);
  const y = scale(lowY, highY, height, 0);
  toPlane = (left, top) => [scale(0, width, lowX, highX)(left), scale(height, 0, lowY, highY)(top)];
  const { values } = map.colours[colour];
  const [low, high] = [Math.min(...values), Math.max(...values)];
  $("colour-scale")?.replaceChildren(`${low.toFixed(2)} `, make("i"), ` ${high.toFixed(2)}`);
  const dots = map.points.map((place, index) => shape("circle", { cx: x(place[0]), cy: y(place[1]), r: index === near ? 8 : 5, class: `intention shade${Math.round(scale(low, high, 0, 8)(values[index]))}` }));
  const path = searchPath().map((place) => [x(place[0]), y(place[1])]);
  const search = path.length ? [line(path, { class: "halo" }), line(path, { class: "lowest" }), ...path.map(([cx, cy]) => shape("circle", { cx, cy, r: 2.5, class: "best" }))] : [];
  return [line([[x(0), 0], [x(0), height]], { class: "grid" }), line([[0, y(0)], [width, y(0)]], { class: "grid" }), ...dots, ...search, shape("circle", { cx: x(point[0]), cy: y(point[1]), r: 10, class: "handle" })];
}
