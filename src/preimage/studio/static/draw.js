// Drawing: pictures and films on canvases, charts as SVG that know their size.

const SVG = "http://www.w3.org/2000/svg";
export const $ = (id) => document.getElementById(id);
export const still = matchMedia("(prefers-reduced-motion: reduce)");

/** An element with attributes, listeners (`onclick`) and children. */
export function make(name, about = {}, ...children) {
  const element = document.createElement(name);
  for (const [key, value] of Object.entries(about)) {
    if (key.startsWith("on")) element.addEventListener(key.slice(2), value);
    else if (value === true) element.setAttribute(key, "");
    else if (value !== false && value != null) element.setAttribute(key, value);
  }
  element.append(...children);
  return element;
}

export function shape(name, about = {}, ...children) {
  const element = document.createElementNS(SVG, name);
  for (const [key, value] of Object.entries(about)) element.setAttribute(key, value);
  element.append(...children);
  return element;
}

/** A picture of the server, which comes as base64. */
export function pictureOf(text) {
  const bytes = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
  return createImageBitmap(new Blob([bytes], { type: "image/png" }));
}

export async function show(canvas, text) {
  const asked = (canvas.asked = (canvas.asked ?? 0) + 1);
  const picture = await pictureOf(text);
  if (asked !== canvas.asked) return; // a later one was asked for meanwhile
  canvas.width = picture.width;
  canvas.height = picture.height;
  canvas.getContext("2d").drawImage(picture, 0, 0);
  canvas.classList.add("shown");
}

export function clear(canvas) {
  canvas.asked = (canvas.asked ?? 0) + 1;
  canvas.getContext("2d").clearRect(0, 0, canvas.width, canvas.height);
  canvas.classList.remove("shown");
}

/** A film: one strip, step 0 on top. */
export class Film {
  static async of(text, height) {
    return new Film(await pictureOf(text), height);
  }
  constructor(strip, height) {
    this.strip = strip;
    this.height = height;
    this.steps = Math.round(strip.height / height);
  }
  draw(canvas, step) {
    const width = this.strip.width;
    if (canvas.width !== width || canvas.height !== this.height) [canvas.width, canvas.height] = [width, this.height];
    const at = Math.max(0, Math.min(step, this.steps - 1)) * this.height;
    canvas.asked = (canvas.asked ?? 0) + 1;
    canvas.getContext("2d").drawImage(this.strip, 0, at, width, this.height, 0, 0, width, this.height);
    canvas.classList.add("shown");
  }
}

const charts = new WeakMap();
const sizes = new ResizeObserver((entries) => entries.forEach(({ target }) => redraw(target)));

/** Draw into an SVG now, and again whenever its size changes: draw(width, height) gives shapes. */
export function chart(svg, draw) {
  if (!charts.has(svg)) sizes.observe(svg);
  charts.set(svg, draw);
  redraw(svg);
}

function redraw(svg) {
  const { width, height } = svg.getBoundingClientRect();
  if (!width || !height) return;
  svg.setAttribute("viewBox", `0 0 ${width} ${height}`);
  svg.replaceChildren(...charts.get(svg)(width, height).filter(Boolean));
}

export const line = (points, about) => shape("polyline", { points: points.map((point) => point.map((value) => +value.toFixed(4)).join(",")).join(" "), ...about });

export const words = (text, x, y, about = {}) => shape("text", { x, y, ...about }, text);

/** From numbers to places on an axis. */
export const scale = (low, high, from, to) => (value) => from + ((value - low) / (high - low || 1)) * (to - from);

export const cm = (value) => `${value.toFixed(1)} cm`;

export function seconds(value) {
  if (value < 90) return `${value < 10 ? value.toFixed(1) : Math.round(value)} s`;
  return value < 5400 ? `${Math.round(value / 60)} min` : `${(value / 3600).toFixed(1)} h`;
}
