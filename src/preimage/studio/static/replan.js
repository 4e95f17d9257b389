// Replan: the arm goes its way with eyes open; whoever looks on pushes it, moves things or wants another goal, and sees what it believes.

import { get, listen, post } from "./api.js";
import { believe, beliefsPanel, clearBeliefs } from "./beliefs.js";
import { $, Film, clear, line, make, shape, show, still } from "./draw.js";
import { setAddress, trouble } from "./main.js";
import { judged } from "./outcome.js";
import { keysMove, mark, placeOf, ring, wayOf } from "./target.js";

const TOUCHES = { push: "Push the arm", object: "Move the object", goal: "Another goal" };
const HELP = {
  push: "Press on the picture, and keep pressing: the hand is led there at the end of every step.",
  object: "Click where the object should stand.",
  goal: "Click where it should go instead.",
};
const PACES = [[1, "the robot's"], [0.5, "half of it"], [0.25, "a quarter"]];
const FRAME_MS = 220; // of what is imagined ahead

let studio;
let picture;
let plan = null; // the job that found the plan
let walk = null; // the job that goes it
let goal = null;
let way = [];
let gone = [];
let film = null;
let ahead = { at: 0, arrival: 0, step: 0 };
let target = [0.5, 0.55];
let kind = "push";
let pressed = null;
let moving = false;
let listening = null;
let timer = null;

export async function prepare(opened, open) {
  studio = opened;
  build();
  if (open.get("walk")) await comeBack(open.get("walk"));
  else await showScene();
}

export async function enter(open) {
  const wanted = open.get("plan");
  if (wanted && wanted !== plan && !moving) await take(wanted);
  remember();
  if (!still.matches) playAhead();
}

export const leave = () => clearTimeout(timer);

function remember() {
  if (!$("replan").hidden) setAddress("replan", walk ? { walk } : plan ? { plan } : {});
}

function build() {
  const choices = studio.table.touches.flatMap((name) => {
    const radio = make("input", { type: "radio", name: "touch", id: `touch-${name}`, onchange: () => choose(name) });
    radio.checked = name === kind;
    return [radio, make("label", { for: `touch-${name}` }, TOUCHES[name])];
  });
  const view = (id, words) => make("figure", {}, make("canvas", { id, width: 64, height: 64, role: "img", "aria-label": words }), make("figcaption", { id: `${id}-words` }, words));
  const table = make("button", { type: "button", class: "picture", id: "walk-table", "aria-describedby": "walk-help", "aria-label": "The table: arrow keys move the target, Enter acts there" }, make("canvas", { id: "walk-scene", width: 64, height: 64 }), shape("svg", { id: "walk-overlay", viewBox: "0 0 1 1", preserveAspectRatio: "none", "aria-hidden": "true" }));
  $("replan").replaceChildren(
    make(
      "div",
      { class: "hero" },
      make(
        "div",
        { class: "scene" },
        make("h1", { id: "replan-title" }, "With eyes open"),
        make("p", { class: "lead" }, "It looks at every step, and plans the rest of its way anew. Disturb it while it moves, and see what it believes."),
        table,
        make("p", { class: "hint", id: "walk-help" }),
        make("div", { class: "row between" }, make("fieldset", { class: "segments", id: "touches", disabled: true }, make("legend", { class: "unseen" }, "What a click does while it moves"), ...choices), make("label", { class: "hint" }, "Speed ", make("select", { id: "pace" }, ...PACES.map(([value, label]) => make("option", { value, selected: value === 0.5 }, label))))),
      ),
      make(
        "div",
        { class: "search" },
        make("div", { class: "row between" }, make("p", { class: "walk-status", id: "walk-status", role: "status" }), make("button", { type: "button", id: "walk-stop", class: "stop", hidden: true, onclick: () => post(`jobs/${walk}/stop`).catch(trouble) }, "Stop: hold the arm"), make("button", { type: "button", id: "walk-go", class: "chief", disabled: true, onclick: () => go().catch(trouble) }, "Execute")),
        make("div", { class: "views" }, view("walk-seen", "sees now"), view("walk-now", "imagined now"), view("walk-ahead", "and ahead"), view("walk-goal", "goal")),
        ...beliefsPanel(studio.disbelief),
      ),
    ),
  );
  picture = $("walk-scene");
  listenToHands(table);
  clearBeliefs();
  help();
}

function choose(name) {
  kind = name;
  help();
}

function help() {
  $("touches").disabled = !moving;
  $("walk-help").textContent = moving ? HELP[kind] : `${studio.table.asks}; then execute. With the keyboard: arrows move the target, Enter acts there.`;
}

function listenToHands(table) {
  table.addEventListener("pointerdown", (event) => {
    target = placeOf(event, picture);
    if (!moving || kind !== "push") return;
    table.setPointerCapture(event.pointerId);
    pressed = target;
    touch().catch(trouble);
  });
  table.addEventListener("pointermove", (event) => pressed && ((pressed = target = placeOf(event, picture)), draw()));
  for (const end of ["pointerup", "pointercancel"]) table.addEventListener(end, () => (pressed = null));
  table.addEventListener("click", (event) => {
    if (moving && kind === "push" && event.detail) return; // the pointer pushed already
    (moving ? touch() : want()).catch(trouble);
  });
  keysMove(table, () => target, (place) => ((target = place), draw()));
  table.addEventListener("focus", draw);
  table.addEventListener("blur", draw);
}

const touch = () => post(`jobs/${walk}/touch`, { kind, seen: target });

// ---- before anything moves

async function showScene() {
  const { large, start } = await get("scene?seed=0");
  await show(picture, large ?? start);
  draw();
}

/** A goal where the target is, and a plan to it. */
async function want() {
  trouble(null);
  const taken = await post("goals/place", { seen: target });
  const { job } = await post("plans", { goal: taken.id, preset: studio.presets.at(-1).name });
  await take(job);
}

/** A plan that was found, or is just being searched for. */
async function take(job) {
  rest();
  [plan, walk, goal, gone, way] = [job, null, (await get(`jobs/${job}`)).about.goal, [], []];
  if (goal.place) target = goal.place;
  clearBeliefs();
  $("walk-go").disabled = true;
  status("planning …");
  [$("walk-seen"), $("walk-now"), $("walk-ahead")].forEach(clear);
  await Promise.all([showScene(), show($("walk-goal"), goal.goal), show($("walk-seen"), goal.start)]);
  remember();
  follow(job, { looked: (event) => event.frame && show($("walk-ahead"), event.frame), done: ({ plan: found }) => planned(found) });
}

async function planned(found) {
  if (found.trust?.refused) status(`The goal is refused: ${found.trust.reasons.join("; ")}. The page of plans lets you go on anyway.`);
  else status("Nothing has moved yet.");
  $("walk-go").disabled = !found.executable;
  way = found.way;
  await imagine(found.film, found.height, 0, found.arrival);
  draw();
}

async function go() {
  $("walk-go").disabled = true;
  const { job } = await post(`jobs/${plan}/walk`, { pace: Number($("pace").value) });
  walk = job;
  begin();
}

async function comeBack(id) {
  try {
    const { about } = await get(`jobs/${id}`);
    [walk, plan, goal] = [id, about.plan, about.goal];
    await show($("walk-goal"), goal.goal);
    begin();
  } catch (error) {
    if (error.status !== 404) throw error;
    await showScene(); // it is too long ago
  }
}

// ---- while it moves

function begin() {
  clearBeliefs();
  [gone, pressed] = [[], null];
  is(true);
  remember();
  status("looking …");
  const over = () => is(false);
  follow(walk, { step: stepped, done: ended, stopped: () => (over(), status("Stopped: the arm is held where it is.")), failed: over });
}

function is(now) {
  moving = now;
  $("walk-stop").hidden = !now;
  $("walk-go").hidden = now;
  $("walk-go").disabled = now || !plan;
  help();
}

async function stepped(event) {
  if (pressed) touch().catch(() => {}); // it may have arrived meanwhile
  gone.push(event.hand);
  if (event.way) way = event.way;
  if (event.goal) await show($("walk-goal"), event.goal);
  if (event.film) await imagine(event.film, studio.frame.height, event.at, event.arrival);
  Object.assign(ahead, { at: event.at, arrival: event.arrival });
  await Promise.all([show(picture, event.picture), event.seen && show($("walk-seen"), event.seen)]);
  film.draw($("walk-now"), event.at);
  if (still.matches) film.draw($("walk-ahead"), event.arrival);
  status(event.held ? `Held: ${event.held}` : event.steps_left ? `${event.steps_left === 1 ? "1 step" : `${event.steps_left} steps`} to the arrival` : "at the goal: one more look");
  believe(event);
  draw();
}

function ended({ ended: how, why, execution }) {
  is(false);
  const words = { arrived: "Arrived: ", held: `Held, because ${why}: `, "given up": "Given up: " };
  $("walk-status").replaceChildren(words[how], ...judged(execution));
}

function follow(job, does) {
  listening?.abort();
  listening = new AbortController();
  const failed = (event) => trouble(new Error(event.detail));
  let before = Promise.resolve(); // pictures take their time; what follows waits for them
  const heard = (event) => (before = before.then(() => Promise.all([does[event.event]?.(event), event.event === "failed" && failed(event)])).catch(trouble));
  listen(job, heard, listening.signal).catch(trouble);
}

/** Whoever leaves a walk holds the arm. */
function rest() {
  listening?.abort();
  if (moving) post(`jobs/${walk}/stop`).catch(() => {}); // it may have ended meanwhile
  is(false);
}

const status = (text) => ($("walk-status").textContent = text);

// ---- pictures

async function imagine(text, height, at, arrival) {
  film = await Film.of(text, height);
  ahead = { at, arrival, step: at };
  if (still.matches) film.draw($("walk-ahead"), arrival);
  else playAhead();
}

function playAhead() {
  clearTimeout(timer);
  if (!film) return;
  ahead.step = ahead.step >= ahead.arrival || ahead.step < ahead.at ? ahead.at : ahead.step + 1;
  film.draw($("walk-ahead"), ahead.step);
  timer = setTimeout(playAhead, FRAME_MS * (ahead.step === ahead.arrival ? 4 : 1));
}

function draw() {
  const shapes = document.activeElement === $("walk-table") || pressed || (goal?.place && !moving) ? ring(target) : [];
  if (way.length) shapes.push(...wayOf(way.slice(ahead.at, ahead.arrival + 1)));
  if (gone.length > 1) shapes.push(line(gone, { class: "executed-way" }));
  if (gone.length) shapes.push(mark(gone.at(-1), "hand"));
  $("walk-overlay").replaceChildren(...shapes);
}
