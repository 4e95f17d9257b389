// What came of a search: the plan, how far to trust it, its execution, and what can be taken along.

import { download, post } from "./api.js";
import { $, clear, cm, line, make, still } from "./draw.js";
import { trouble } from "./main.js";
import { state } from "./state.js";
import { mark, ring, wayOf } from "./target.js";

const VERDICTS = { reached: "It imagines to reach the goal", near: "It imagines to come near", "in doubt": "In doubt: it does not see itself arrive" };
const FILES = {
  "Joints (CSV)": (job) => download(`jobs/${job}/joints.csv`, "joints.csv"),
  "Episode (LeRobot)": (job) => download(`jobs/${job}/lerobot.zip`, "lerobot.zip"),
  "Film (MP4)": (job) => download(`jobs/${job}/film.mp4`, "plan.mp4"),
};

export function buildOutcome() {
  $("execute").addEventListener("click", () => execute().catch(trouble));
  $("anyway").addEventListener("click", () => goOn().catch(trouble));
  $("copy").addEventListener("click", () => copy().catch(trouble));
}

export function hideOutcome() {
  for (const name of ["found", "execute", "anyway", "walk-link"]) $(name).hidden = true;
}

/** A plan that was found; `known` says whether it was executed before, and whether a refusal was gone beyond. */
export async function showPlan(plan, known) {
  state.found = plan;
  const { trust } = plan;
  $("verdict").textContent = trust?.refused ? "Refused: unlike any goal that was reached" : (VERDICTS[plan.verdict] ?? "A plan");
  $("trust").replaceChildren(...trustWords(trust));
  $("reasons").replaceChildren(...[...(trust?.reasons ?? []), ...plan.reasons].map((reason) => make("li", {}, reason)));
  $("executed-figure").hidden = !plan.executable;
  $("executed-words").textContent = "executed: nothing has moved yet";
  $("command").textContent = plan.command;
  $("command-words").textContent = plan.command.includes("GOAL:") ? "Copy keeps start and goal on disk first, and puts their place for GOAL." : "";
  clear($("film-executed"));
  $("found").hidden = false;
  offer(Boolean(trust?.refused) && !known?.anyway);
  await state.player.load(plan);
  if (known?.execution) await showExecution(known.execution);
  else if (!still.matches) state.player.play();
}

function trustWords(trust) {
  if (!trust) return [];
  const share = trust.probability == null ? [] : [make("strong", { class: trust.refused ? "bad" : "" }, `${Math.round(100 * trust.probability)} %`), " likely to succeed"];
  return [...share, make("span", { class: "note" }, share.length ? ` ${trust.note}` : `${trust.note[0].toUpperCase()}${trust.note.slice(1)}`)];
}

/** What may be done with the plan: of one whose goal is refused only to go on anyway. */
function offer(refused) {
  const { found, job } = state;
  $("anyway").hidden = !refused;
  $("execute").hidden = refused || !found.executable;
  $("execute").disabled = false;
  $("walk-link").hidden = refused || !found.executable;
  $("walk-link").href = `#/replan?plan=${job}`;
  const say = refused ? "Nothing has moved, and nothing will unless you go on anyway." : "Nothing has moved yet: execute lets the arm follow what was imagined.";
  $("deviation").textContent = found.executable ? say : "";
  $("downloads").replaceChildren(...(refused ? [] : Object.entries(FILES).map(([label, take]) => make("button", { type: "button", onclick: () => take(job).catch(trouble) }, label))));
}

async function goOn() {
  await post(`jobs/${state.job}/anyway`);
  offer(false);
  $(state.found.executable ? "execute" : "copy").focus();
}

async function execute() {
  $("execute").disabled = true;
  $("deviation").textContent = "moving …";
  try {
    await showExecution(await post(`jobs/${state.job}/execution`));
    $("found").scrollIntoView({ behavior: still.matches ? "auto" : "smooth" });
    if (!still.matches) state.player.play();
  } catch (error) {
    $("execute").disabled = false;
    $("deviation").textContent = "";
    throw error;
  }
}

/** How an execution ended, in words. */
export function judged(executed) {
  const end = executed.deviation_cm == null ? ["It moved. Nobody knows where this goal is on the table, so nothing is measured."] : [make("strong", { class: executed.success ? "good" : "bad" }, executed.success ? "✓ reached" : "✗ missed"), ` ${cm(executed.deviation_cm)} off`];
  return [...end, ...[...executed.details, ...executed.limited].map((words) => make("span", {}, ` · ${words}`))];
}

async function showExecution(execution) {
  state.executed = execution;
  $("execute").disabled = true;
  $("executed-words").textContent = "executed";
  $("deviation").replaceChildren(...judged(execution));
  await state.player.add(execution);
}

/** The target, the way of the hand, and where it is at a step. */
export function drawHand(step) {
  const { found, executed, goal, target } = state;
  const shapes = goal?.place || document.activeElement === $("table") ? ring(target) : [];
  if (found?.way) {
    shapes.push(...wayOf(found.way.slice(0, found.arrival + 1)));
    if (executed) shapes.push(line(executed.way, { class: "executed-way" }));
    const now = (executed && step < executed.way.length ? executed.way : found.way)[Math.min(step, found.way.length - 1)];
    if (now) shapes.push(mark(now, "hand"));
  }
  $("overlay").replaceChildren(...shapes);
}

async function copy() {
  const { command } = await post(`jobs/${state.job}/kept`);
  $("command").textContent = command;
  try {
    await navigator.clipboard.writeText(command);
    $("command-words").textContent = "Copied.";
  } catch {
    getSelection().selectAllChildren($("command"));
    $("command-words").textContent = "The browser does not let the page copy here: it is marked, press Ctrl+C.";
  }
}
