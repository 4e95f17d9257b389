// A picture of the table that is clicked, or gone over with the arrow keys: both give a place on it, as shares of its width and height.

import { line } from "./draw.js";

const KEY_STEP = 0.02; // share of the picture that an arrow key moves the target by
const KEYS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
const inside = (share) => Math.min(1, Math.max(0, share));

/** Where on a picture the pointer is. */
export function placeOf(event, picture) {
  const box = picture.getBoundingClientRect();
  return [inside((event.clientX - box.left) / box.width), inside((event.clientY - box.top) / box.height)];
}

/** Arrow keys move a target: `at()` tells where it is, `moved(place)` where it goes. */
export function keysMove(element, at, moved) {
  element.addEventListener("keydown", (event) => {
    const by = KEYS[event.key];
    if (!by) return;
    event.preventDefault();
    moved(at().map((share, axis) => inside(share + by[axis] * KEY_STEP)));
  });
}

export const mark = (at, about) => line([at, at], { class: about });

export const ring = (at) => [mark(at, "target"), mark(at, "target-inside")];

/** A way over the picture, dark below and bright above. */
export const wayOf = (places) => [line(places, { class: "halo" }), line(places, { class: "way" }), ...places.map((at) => mark(at, "step"))];
