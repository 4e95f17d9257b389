// Plan: a goal, the search as it goes on, and what came of it.

import { get, listen, post } from "./api.js";
import { $, clear, make, seconds, show } from "./draw.js";
import { setAddress, trouble } from "./main.js";
import { buildOutcome, drawHand, hideOutcome, showPlan } from "./outcome.js";
import { Player } from "./player.js";
import { drawSearch } from "./search.js";
import { buildSources } from "./sources.js";
import { state } from "./state.js";
import { keysMove, placeOf } from "./target.js";

let listening = null;

export async function prepare(opened, open) {
  state.studio = opened;
  state.seed = Number(open.get("seed") ?? 0) || 0;
  state.preset = open.get("preset") ?? opened.presets.at(-1).name;
  state.player = new Player(opened, drawHand);
  buildPresets();
  buildTable();
  buildSources(take);
  buildOutcome();
  $("go").addEventListener("click", () => plan().catch(trouble));
  $("stop").addEventListener("click", () => post(`jobs/${state.job}/stop`).catch(trouble));
  drawSearch();
  const sceneShown = showScene();
  if (open.get("job")) await comeBack(open.get("job"));
  await sceneShown;
}

export function enter() {
  remember();
}

function remember() {
  const { job, seed, preset } = state;
  if (!$("plan").hidden) setAddress("plan", { ...(job && { job }), ...(seed && { seed }), preset });
}

// ---- the scene, and goals

async function showScene() {
  const { studio } = state;
  state.scene = await get(`scene?seed=${state.seed}`);
  await showStart();
  $("asks").textContent = studio.table ? `${studio.table.asks}: it imagines the way there before anything moves.` : "Give it a picture of how things should look in the end: it imagines the way there.";
  $("table").disabled = !studio.table;
  $("table").setAttribute("aria-label", studio.table ? "The table: arrow keys move the target, Enter plans to it" : "What the camera sees at the start");
  $("table-help").textContent = studio.table ? "Or drop or paste a picture anywhere. With the keyboard: arrows move the target, Enter takes it." : "Drop or paste a picture anywhere.";
  $("from-now").hidden = !studio.table; // of another robot nothing is seen now
  $("another").hidden = !studio.table?.things.length;
  if (studio.table) await dim();
  drawHand(0);
}

/** Where the plan starts: on the table, or where the episode of a chosen frame does. */
const showStart = () => show($("scene"), state.goal?.kind === "frame" ? state.goal.start : (state.scene.large ?? state.scene.start));

async function dim() {
  const rows = await get("reachable");
  const canvas = $("dim");
  const context = canvas.getContext("2d");
  canvas.width = canvas.height = rows.length;
  context.fillStyle = "#0b0d10";
  rows.forEach((row, y) => [...row].forEach((cell, x) => cell === "0" && context.fillRect(x, y, 1, 1)));
  canvas.hidden = false;
}

function buildTable() {
  const redraw = () => drawHand(state.player.step);
  $("table").addEventListener("click", (event) => {
    if (event.detail) state.target = placeOf(event, $("scene"));
    take(() => post("goals/place", { seen: state.target, seed: state.seed }));
  });
  keysMove($("table"), () => state.target, (place) => ((state.target = place), redraw()));
  $("table").addEventListener("focus", redraw);
  $("table").addEventListener("blur", redraw);
  $("another").addEventListener("click", () => {
    state.seed += 1;
    forget();
    showScene().catch(trouble);
    remember();
  });
}

function buildPresets() {
  const { presets } = state.studio;
  const choose = (name) => {
    state.preset = name;
    $("way").textContent = presets.find((each) => each.name === name).way;
    remember();
  };
  for (const { name } of presets) {
    const radio = make("input", { type: "radio", name: "preset", value: name, id: `preset-${name}`, onchange: () => (choose(name), state.goal && plan().catch(trouble)) });
    radio.checked = name === state.preset;
    $("presets").append(radio, make("label", { for: `preset-${name}` }, name));
  }
  choose(presets.some(({ name }) => name === state.preset) ? state.preset : presets.at(-1).name);
}

/** A new goal, and at once the search for a plan to it. */
async function take(ask) {
  trouble(null);
  try {
    const taken = await ask();
    forget();
    showGoal(taken);
    await plan();
  } catch (error) {
    trouble(error);
  }
}

function showGoal(taken) {
  state.goal = taken;
  if (taken.place) state.target = taken.place;
  $("go").disabled = false;
  show($("goal"), taken.goal).catch(trouble);
  if (state.scene) showStart().catch(trouble);
  show($("film-goal"), taken.goal).catch(trouble);
  drawHand(0);
}

/** Whoever leaves a plan that is still searched for stops it. */
function letGo() {
  listening?.abort();
  if (state.job && !$("stop").hidden) post(`jobs/${state.job}/stop`).catch(() => {}); // it may have ended meanwhile
}

function forget() {
  letGo();
  Object.assign(state, { goal: null, job: null, found: null, executed: null, seen: [] });
  hideOutcome();
  $("go").disabled = true;
  [$("goal"), $("arriving")].forEach(clear);
  drawSearch();
}

// ---- the search

async function plan() {
  const { job } = await post("plans", { goal: state.goal.id, preset: state.preset });
  follow(job);
}

async function comeBack(id) {
  try {
    const known = await get(`jobs/${id}`);
    state.preset = known.about.preset;
    const radio = $(`preset-${state.preset}`);
    if (radio) radio.checked = true;
    showGoal(known.about.goal);
    follow(id, known);
  } catch (error) {
    if (error.status !== 404) trouble(error); // it is too long ago
  }
}

function follow(id, known = null) {
  letGo();
  listening = new AbortController();
  Object.assign(state, { job: id, found: null, executed: null, seen: [] });
  listen(id, (event) => heard(event, known).catch(trouble), listening.signal).catch((error) => {
    searching(false);
    trouble(error);
  }); // first of all: the page is drawn anew while the first point is under way
  hideOutcome();
  clear($("arriving"));
  drawSearch();
  remember();
  searching(true);
}

function searching(is) {
  $("stop").hidden = !is;
  $("plan").classList.toggle("searching", is);
}

async function heard(event, known) {
  const told = {
    waiting: () => status(event.ahead ? `waiting for ${event.ahead === 1 ? "a plan" : `${event.ahead} plans`} before this one` : "asking the network …"),
    began: () => status("first guesses …"),
    looked: () => looked(event),
    done: () => done(event.plan, known),
    stopped: () => (searching(false), status(`stopped after ${number(state.seen.length)}`)),
    failed: () => (searching(false), status(""), trouble(new Error(event.detail))),
  };
  await told[event.event]();
}

const status = (text) => ($("status").textContent = text);
const number = (count) => (count === 1 ? "1 evaluation" : `${count} evaluations`);

function looked(event) {
  state.seen.push(event);
  if (event.frame) show($("arriving"), event.frame).catch(trouble);
  const left = event.left_s >= 0.1 ? `, at most ${seconds(event.left_s)} left` : "";
  status(`evaluation ${event.n}${left}`);
  drawSearch();
}

async function done(plan, known) {
  searching(false);
  status(`planned in ${seconds(plan.seconds)}, ${number(state.seen.length)}`);
  await showPlan(plan, known);
  drawSearch();
}
