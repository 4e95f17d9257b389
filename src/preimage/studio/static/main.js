// The pages, and which of them is shown: the address after # says it, so that a reload comes back to the same place.

import { get } from "./api.js";
import { $, still } from "./draw.js";
import * as plan from "./plan.js";
import * as replan from "./replan.js";
import * as intentions from "./intentions.js";
import * as demonstrations from "./demonstrations.js";
import * as training from "./training.js";
import * as results from "./results.js";

const PAGES = { plan, replan, intentions, demonstrations, training, results };
const ready = new Set();
let opened;

export function trouble(error) {
  if (error?.name === "AbortError") return;
  $("trouble").textContent = error ? error.message.replace(/^[a-z]+(?= )/, (word) => word[0].toUpperCase() + word.slice(1)) : ""; // but no name of a file
  $("trouble").hidden = !error;
}

/** The address after #: a page and what is open on it. */
export function address() {
  const [path, query] = location.hash.replace(/^#\/?/, "").split("?");
  return { page: path in PAGES ? path : "plan", open: new URLSearchParams(query) };
}

export function setAddress(page, open) {
  const query = new URLSearchParams(open).toString();
  history.replaceState(null, "", `#/${page}${query ? `?${query}` : ""}`);
}

async function turn() {
  if (!opened) return;
  const { page, open } = address();
  trouble(null);
  for (const name of Object.keys(PAGES)) {
    $(name).hidden = name !== page;
    const link = document.querySelector(`nav a[href="#/${name}"]`);
    if (name === page) link.setAttribute("aria-current", "page");
    else link.removeAttribute("aria-current");
    if (name !== page) PAGES[name].leave?.();
  }
  try {
    if (!ready.has(page)) {
      ready.add(page);
      await PAGES[page].prepare(opened, open);
    }
    await PAGES[page].enter?.(open);
  } catch (error) {
    ready.delete(page);
    trouble(error);
  }
}

async function begin() {
  document.documentElement.classList.toggle("still", still.matches);
  window.addEventListener("hashchange", turn);
  window.addEventListener("unhandledrejection", (event) => {
    event.preventDefault();
    trouble(event.reason);
  });
  try {
    opened = await get("studio");
    const made = opened.made.num_demonstrations ? ` · ${opened.made.num_demonstrations} demonstrations` : "";
    $("run").textContent = `${opened.run}${made}`;
    document.querySelector('nav a[href="#/replan"]').hidden = !opened.table;
    document.querySelector('nav a[href="#/demonstrations"]').hidden = !opened.data.length;
    document.querySelector('nav a[href="#/training"]').hidden = !opened.has_runs;
    document.querySelector('nav a[href="#/results"]').hidden = !opened.has_results;
    await turn();
  } catch (error) {
    trouble(error);
  }
}

begin();
