// One playhead over the imagined film, the executed film and the joint curves.

import { $, Film, chart, line, make, scale, seconds, shape } from "./draw.js";

const SLOWEST_MS = 400; // a frame at the network's 2.5 Hz takes as long as it took
const END_MS = 1200; // the last frame stays a while before the film begins again

export class Player {
  constructor(studio, moved) {
    this.studio = studio;
    this.moved = moved;
    this.step = 0;
    this.timer = null;
    $("head").addEventListener("input", () => (this.pause(), this.go(Number($("head").value))));
    $("head").addEventListener("keydown", (event) => event.key === " " && (event.preventDefault(), this.toggle()));
    $("play").addEventListener("click", () => this.toggle());
  }

  async load(plan) {
    this.pause();
    [this.plan, this.executed, this.executedFilm] = [plan, null, null];
    this.film = await Film.of(plan.film, plan.height);
    this.last = plan.steps - 1;
    $("head").max = this.last;
    this.buildJoints();
    this.go(0);
  }

  async add(executed) {
    this.executedFilm = await Film.of(executed.film, this.plan.height);
    this.executed = executed;
    this.last = Math.max(this.plan.steps, executed.steps) - 1;
    $("head").max = this.last;
    this.go(0);
  }

  go(step) {
    this.step = step;
    $("head").value = step;
    this.film.draw($("film-imagined"), step);
    if (this.executedFilm) this.executedFilm.draw($("film-executed"), step);
    const when = step === this.plan.arrival ? ", arrival" : "";
    $("head-words").textContent = `step ${step} of ${this.last}${when}`;
    $("head").setAttribute("aria-valuetext", `step ${step} of ${this.last}, ${seconds(step / this.plan.rate_hz)}${when}`);
    this.charts.forEach((svg, joint) => chart(svg, (width, height) => this.drawJoint(joint, width, height)));
    this.moved(step);
  }

  play() {
    this.pause();
    $("play").textContent = "❚❚";
    $("play").setAttribute("aria-label", "Pause");
    const advance = () => {
      const end = this.step >= this.last;
      this.go(end ? 0 : this.step + 1);
      const wait = this.step >= this.last ? END_MS : Math.min(SLOWEST_MS, 1000 / this.plan.rate_hz);
      this.timer = setTimeout(advance, wait);
    };
    this.timer = setTimeout(advance, SLOWEST_MS);
  }

  pause() {
    clearTimeout(this.timer);
    this.timer = null;
    $("play").textContent = "▶";
    $("play").setAttribute("aria-label", "Play");
  }

  toggle() {
    if (this.timer) this.pause();
    else this.play();
  }

  buildJoints() {
    this.charts = this.studio.joints.map(({ name }) => shape("svg", { role: "img", "aria-label": `${name}: imagined and executed` }));
    this.values = this.studio.joints.map(() => make("output", {}));
    $("joints").replaceChildren(
      ...this.studio.joints.map(({ name }, joint) => make("figure", {}, make("figcaption", { class: "row between" }, make("span", {}, name), this.values[joint]), this.charts[joint])),
    );
  }

  drawJoint(joint, width, height) {
    const { lower, upper, unit } = this.studio.joints[joint];
    const imagined = this.plan.joints.map((row) => row[joint]);
    const executed = this.executed?.joints.map((row) => row[joint]) ?? [];
    const at = Math.min(this.step, imagined.length - 1);
    this.values[joint].textContent = `${(Math.round(100 * imagined[at]) / 100 + 0).toFixed(2)} ${unit}`;
    const [low, high] = [Math.min(lower, ...imagined, ...executed), Math.max(upper, ...imagined, ...executed)];
    const x = scale(0, this.last, 4, width - 4);
    const y = scale(low, high, height - 6, 6);
    const path = (values) => values.map((value, step) => [x(step), y(value)]);
    const across = (value, about) => line([[0, y(value)], [width, y(value)]], about);
    const upright = (step, about) => line([[x(step), 0], [x(step), height]], about);
    return [
      across(lower, { class: "limit" }), across(upper, { class: "limit" }), upright(this.plan.arrival, { class: "arrival" }), upright(this.step, { class: "playhead" }),
      line(path(imagined), { class: "imagined" }), executed.length && line(path(executed), { class: "executed" }),
      shape("circle", { cx: x(at), cy: y(imagined[at]), r: 3.5, class: "best" }),
    ];
  }
}
