// What the page of plans and the rooms it is made of have in common: what is wanted, what is searched for, and what was found.

export const state = {
  studio: null, // what was opened
  player: null, // the playhead over the films
  seed: 0, // of the scene
  scene: null,
  preset: "full",
  goal: null,
  job: null, // of the plan
  seen: [], // what the search evaluated so far
  found: null, // the plan
  executed: null,
  target: [0.5, 0.55], // where a key press takes the goal
};
