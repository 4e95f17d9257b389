// Where goals come from besides a click: a picture that is chosen, dropped or pasted, and a frame of a demonstration.

import { get, post, upload } from "./api.js";
import { $, Film, make } from "./draw.js";
import { trouble } from "./main.js";
import { state } from "./state.js";

/** Goals by these ways are handed on as `take(ask)`, where ask() asks the server for the goal. */
export function buildSources(take) {
  const { most_uploaded: most } = state.studio;
  const picture = (file) => file && take(() => {
    if (file.size > most) throw new Error(`${file.name} has more than ${most / 2 ** 20} MB: give a smaller picture`); // a server that stops reading is taken for one that is not there
    return upload(`goals/picture?seed=${state.seed}`, file);
  });
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
  $("from-now").addEventListener("click", () => take(() => post("goals/current", { job: state.executed ? state.job : null, seed: state.seed })));
  if (state.studio.data.length) buildFrames(take);
}

function buildFrames(take) {
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
    const { episodes } = state.studio.data.find((each) => each.name === data.value);
    episode.replaceChildren(...episodes.map((number) => make("option", {}, `${number}`)));
    return pick();
  };
  data.replaceChildren(...state.studio.data.map(({ name }) => make("option", {}, name)));
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
