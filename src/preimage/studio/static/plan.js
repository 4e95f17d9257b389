// Plan: a goal, the search as it goes on, and what came of it.

import { download, get, listen, post, upload } from "./api.js";
import { $, Film, chart, clear, cm, line, make, scale, seconds, shape, show, still, words } from "./draw.js";
import { setAddress, trouble } from "./main.js";
import { Player } from "./player.js";

const KEY_STEP = 0.02; // share of the picture that an arrow key moves the target by
const TICKS = [0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 50, 100, 200];

let studio;
let player;
let seed = 0;
let scene = null;
let preset = "full";
let goal = null;
let job = null;
let found = null;
let executed = null;
let target = [0.5, 0.55];
let seen = [];
let listening = null;

export async function prepare(opened, open) {
  studio = opened;
  seed = Number(open.get("seed") ?? 0) || 0;
  preset = open.get("preset") ?? studio.presets.at(-1).name;
  player = new Player(studio, drawHand);
  buildPresets();
  buildSources();
  $("go").addEventListener("click", () => plan().catch(trouble));
  $("stop").addEventListener("click", () => post(`jobs/${job}/stop`).catch(trouble));
  $("execute").addEventListener("click", () => execute().catch(trouble));
  $("copy").addEventListener("click", () => copy().catch(trouble));
  chart($("errors"), drawErrors);
  chart($("arrivals"), drawArrivals);
  const sceneShown = showScene();
  if (open.get("job")) await comeBack(open.get("job"));
  await sceneShown;
}

export function enter() {
  remember();
}

function remember() {
  setAddress("plan", { ...(job && { job }), ...(seed && { seed }), preset });
}

// ---- the scene, and goals

async function showScene() {
  scene = await get(`scene?seed=${seed}`);
  await showStart();
  $("asks").textContent = studio.table ? `${studio.table.asks}: it imagines the way there before anything moves.` : "Give it a picture of how things shall look in the end: it imagines the way there.";
  $("table").disabled = !studio.table;
  $("table").setAttribute("aria-label", studio.table ? "The table: arrow keys move the target, Enter plans to it" : "What the camera sees at the start");
  $("table-help").textContent = studio.table ? "Or drop or paste a picture anywhere. With the keyboard: arrows move the target, Enter takes it." : "Drop or paste a picture anywhere.";
  $("another").hidden = !studio.table?.things.length;
  if (studio.table) await dim();
  drawHand(0);
}

/** Where the plan starts: on the table, or where the episode of a chosen frame does. */
const showStart = () => show($("scene"), goal?.kind === "frame" ? goal.start : (scene.large ?? scene.start));

async function dim() {
  const rows = await get("reachable");
  const canvas = $("dim");
  const context = canvas.getContext("2d");
  canvas.width = canvas.height = rows.length;
  context.fillStyle = "#0b0d10";
  rows.forEach((row, y) => [...row].forEach((cell, x) => cell === "0" && context.fillRect(x, y, 1, 1)));
  canvas.hidden = false;
}

function buildSources() {
  const table = $("table");
  table.addEventListener("click", (event) => {
    if (event.detail) {
      const box = $("scene").getBoundingClientRect();
      target = [(event.clientX - box.left) / box.width, (event.clientY - box.top) / box.height].map((share) => Math.min(1, Math.max(0, share)));
    }
    take(() => post("goals/place", { seen: target, seed }));
  });
  table.addEventListener("keydown", (event) => {
    const by = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] }[event.key];
    if (!by) return;
    event.preventDefault();
    target = target.map((share, axis) => Math.min(1, Math.max(0, share + by[axis] * KEY_STEP)));
    drawHand(player.step);
  });
  table.addEventListener("focus", () => drawHand(player.step));
  table.addEventListener("blur", () => drawHand(player.step));
  const picture = (file) => file && take(() => upload(`goals/picture?seed=${seed}`, file));
  $("file").addEventListener("change", (event) => {
    picture(event.target.files[0]);
    event.target.value = "";
  });
  window.addEventListener("paste", (event) => !$("plan").hidden && picture([...event.clipboardData.files].find((file) => file.type.startsWith("image/"))));
  window.addEventListener("dragover", (event) => event.preventDefault());
  window.addEventListener("drop", (event) => {
    event.preventDefault();
    if (!$("plan").hidden) picture(event.dataTransfer.files[0]);
  });
  $("from-now").addEventListener("click", () => take(() => post("goals/current", { job: executed ? job : null, seed })));
  $("another").addEventListener("click", () => {
    seed += 1;
    forget();
    showScene().catch(trouble);
    remember();
  });
  if (studio.data.length) buildFrames();
}

function buildFrames() {
  const [data, episode, step] = ["frame-data", "frame-episode", "frame-step"].map($);
  let film = null;
  let shown = null;
  const preview = () => {
    $("frame-step-shown").textContent = shown.steps[step.value];
    film.draw($("frame-preview"), Number(step.value));
  };
  const pick = async () => {
    shown = await get(`data/${encodeURIComponent(data.value)}/episodes/${episode.value}`);
    film = await Film.of(shown.film, shown.height);
    step.max = film.steps - 1;
    step.value = step.max;
    preview();
  };
  const list = () => {
    const { episodes } = studio.data.find((each) => each.name === data.value);
    episode.replaceChildren(...episodes.map((number) => make("option", {}, `${number}`)));
    return pick();
  };
  data.replaceChildren(...studio.data.map(({ name }) => make("option", {}, name)));
  data.addEventListener("change", () => list().catch(trouble));
  episode.addEventListener("change", () => pick().catch(trouble));
  step.addEventListener("input", preview);
  $("from-frame").hidden = false;
  $("from-frame").addEventListener("click", () => {
    const chooser = $("frame-chooser");
    chooser.hidden = !chooser.hidden;
    $("from-frame").setAttribute("aria-expanded", `${!chooser.hidden}`);
    if (!chooser.hidden && !film) list().catch(trouble);
  });
  $("frame-chooser").addEventListener("submit", (event) => {
    event.preventDefault();
    take(() => post("goals/frame", { data: data.value, episode: Number(episode.value), step: shown.steps[step.value] }));
  });
}

function buildPresets() {
  const choose = (name) => {
    preset = name;
    $("way").textContent = studio.presets.find((each) => each.name === name).way;
    remember();
  };
  for (const { name } of studio.presets) {
    const radio = make("input", { type: "radio", name: "preset", value: name, id: `preset-${name}`, onchange: () => (choose(name), goal && plan().catch(trouble)) });
    radio.checked = name === preset;
    $("presets").append(radio, make("label", { for: `preset-${name}` }, name));
  }
  choose(studio.presets.some(({ name }) => name === preset) ? preset : studio.presets.at(-1).name);
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
  goal = taken;
  if (goal.place) target = goal.place;
  $("go").disabled = false;
  show($("goal"), goal.goal).catch(trouble);
  if (scene) showStart().catch(trouble);
  show($("film-goal"), goal.goal).catch(trouble);
  drawHand(0);
}

/** Whoever leaves a plan that is still searched for stops it. */
function letGo() {
  listening?.abort();
  if (job && !$("stop").hidden) post(`jobs/${job}/stop`).catch(() => {}); // it may have ended meanwhile
}

function forget() {
  letGo();
  goal = job = found = executed = null;
  seen = [];
  $("found").hidden = $("execute").hidden = true;
  $("go").disabled = true;
  [$("goal"), $("arriving")].forEach(clear);
  redrawSearch();
}

// ---- the search

async function plan() {
  const { job: id } = await post("plans", { goal: goal.id, preset });
  follow(id);
}

async function comeBack(id) {
  try {
    const { about, execution } = await get(`jobs/${id}`);
    preset = about.preset;
    const radio = $(`preset-${preset}`);
    if (radio) radio.checked = true;
    showGoal(about.goal);
    follow(id, execution);
  } catch (error) {
    if (error.status !== 404) trouble(error); // it is too long ago
  }
}

function follow(id, execution = null) {
  letGo();
  listening = new AbortController();
  [job, found, executed, seen] = [id, null, null, []];
  $("found").hidden = $("execute").hidden = true;
  clear($("arriving"));
  redrawSearch();
  remember();
  searching(true);
  listen(id, (event) => heard(event, execution).catch(trouble), listening.signal).catch((error) => {
    searching(false);
    trouble(error);
  });
}

function searching(is) {
  $("stop").hidden = !is;
  $("plan").classList.toggle("searching", is);
}

async function heard(event, execution) {
  const told = {
    waiting: () => status(event.ahead ? `waiting for ${event.ahead === 1 ? "a plan" : `${event.ahead} plans`} before this one` : "asking the network …"),
    began: () => status("first guesses …"),
    looked: () => looked(event),
    done: () => showPlan(event.plan, execution),
    stopped: () => (searching(false), status(`stopped after ${seen.length} evaluations`)),
    failed: () => (searching(false), status(""), trouble(new Error(event.detail))),
  };
  await told[event.event]();
}

const status = (text) => ($("status").textContent = text);

function looked(event) {
  seen.push(event);
  if (event.frame) show($("arriving"), event.frame).catch(trouble);
  const left = event.left_s >= 0.1 ? `, at most ${seconds(event.left_s)} left` : "";
  status(`evaluation ${event.n}${left}`);
  redrawSearch();
}

function redrawSearch() {
  const best = bestSeen();
  $("error-now").textContent = best ? best.error.toPrecision(3) : "";
  $("arriving-words").textContent = best ? `imagined arrival, step ${best.arrival}` : "imagined arrival";
  chart($("errors"), drawErrors);
  chart($("arrivals"), drawArrivals);
}

function drawErrors(width, height) {
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

/** The evaluation with the lowest error so far, whose arrival is shown: it alone came with a picture. */
const bestSeen = () => seen.findLast(({ frame }) => frame);

function drawArrivals(width, height) {
  const best = bestSeen();
  const steps = found?.steps ?? studio?.steps ?? 16;
  const x = scale(0, steps - 1, 14, width - 14);
  const y = height / 2 - 6;
  const marks = Array.from({ length: steps }, (_, step) => shape("circle", { cx: x(step), cy: y, r: 1.6, class: "tickmark" }));
  const base = [line([[14, y], [width - 14, y]], { class: "axis" }), ...marks, (!best || x(best.arrival) > 120) && words("start", 8, height - 3, { class: "tick" }), (!best || x(best.arrival) < width - 140) && words("horizon", width - 8, height - 3, { class: "tick end" })];
  if (!best) return base;
  const others = seen.at(-1).arrivals.map((step) => shape("circle", { cx: x(step), cy: y, r: 4, class: "dot" }));
  return [...base, ...others, shape("circle", { cx: x(best.arrival), cy: y, r: 7, class: "best" }), words(`arrives at step ${best.arrival}`, Math.min(Math.max(x(best.arrival), 66), width - 66), height - 3, { class: "tick middle strong" })];
}

// ---- what came of it

async function showPlan(plan, execution) {
  searching(false);
  found = plan;
  const words = { reached: "It imagines to reach the goal", near: "It imagines to come near", "in doubt": "In doubt: it does not see itself arrive" };
  $("verdict").textContent = words[plan.verdict] ?? "A plan";
  $("verdict").dataset.verdict = plan.verdict ?? "";
  $("reasons").replaceChildren(...plan.reasons.map((reason) => make("li", {}, reason)));
  status(`planned in ${seconds(plan.seconds)}, ${seen.length === 1 ? "1 evaluation" : `${seen.length} evaluations`}`);
  $("deviation").textContent = plan.executable ? "Nothing has moved yet: execute lets the arm follow what was imagined." : "";
  $("execute").hidden = !plan.executable;
  $("execute").disabled = false;
  $("executed-figure").hidden = !plan.executable;
  $("executed-words").textContent = "executed: nothing has moved yet";
  $("command").textContent = plan.command;
  $("command-words").textContent = plan.command.includes("GOAL:") ? "Copy keeps start and goal on disk first, and puts their place for GOAL." : "";
  $("downloads").replaceChildren(
    make("button", { type: "button", onclick: () => download(`jobs/${job}/joints.csv`, "joints.csv").catch(trouble) }, "Joints (CSV)"),
    make("button", { type: "button", onclick: () => download(`jobs/${job}/lerobot.zip`, "lerobot.zip").catch(trouble) }, "Episode (LeRobot)"),
    make("button", { type: "button", onclick: () => download(`jobs/${job}/film.mp4`, "plan.mp4").catch(trouble) }, "Film (MP4)"),
  );
  clear($("film-executed"));
  $("found").hidden = false;
  await player.load(plan);
  if (execution) await showExecution(execution);
  else if (!still.matches) player.play();
  redrawSearch();
}

async function execute() {
  $("execute").disabled = true;
  $("deviation").textContent = "moving …";
  try {
    await showExecution(await post(`jobs/${job}/execution`));
    $("found").scrollIntoView({ behavior: still.matches ? "auto" : "smooth" });
    if (!still.matches) player.play();
  } catch (error) {
    $("execute").disabled = false;
    $("deviation").textContent = "";
    throw error;
  }
}

async function showExecution(execution) {
  executed = execution;
  $("execute").disabled = true;
  $("executed-words").textContent = "executed";
  const judged = executed.deviation_cm == null ? ["It moved. Nobody knows where this goal is on the table, so nothing is measured."] : [make("strong", { class: executed.success ? "good" : "bad" }, executed.success ? "✓ reached" : "✗ missed"), ` ${cm(executed.deviation_cm)} off`];
  $("deviation").replaceChildren(...judged, ...[...executed.details, ...executed.limited].map((words) => make("span", {}, ` · ${words}`)));
  await player.add(executed);
}

/** The target, the way of the hand, and where it is at a step. */
function drawHand(step) {
  const [black, bright] = ["halo", "way"];
  const shapes = [];
  const mark = (at, about) => shapes.push(line([at, at], about));
  if (goal?.place || document.activeElement === $("table")) {
    mark(target, { class: "target" });
    mark(target, { class: "target-inside" });
  }
  if (found?.way) {
    const way = found.way.slice(0, found.arrival + 1);
    shapes.push(line(way, { class: black }), line(way, { class: bright }));
    way.forEach((at) => mark(at, { class: "step" }));
    if (executed) shapes.push(line(executed.way, { class: "executed-way" }));
    const now = (executed && step < executed.way.length ? executed.way : found.way)[Math.min(step, found.way.length - 1)];
    if (now) mark(now, { class: "hand" });
  }
  $("overlay").replaceChildren(...shapes);
}

async function copy() {
  const { command } = await post(`jobs/${job}/kept`);
  $("command").textContent = command;
  try {
    await navigator.clipboard.writeText(command);
    $("command-words").textContent = "Copied.";
  } catch {
    getSelection().selectAllChildren($("command"));
    $("command-words").textContent = "The browser does not let the page copy here: it is marked, press Ctrl+C.";
  }
}

/** The way of the last search in the plane of intentions, best point by best point. */
export function searchPath() {
  let lowest = Infinity;
  return seen.filter(({ error }) => error < lowest && ((lowest = error), true)).map(({ point }) => point);
}
