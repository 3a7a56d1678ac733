// How a motion was made, as steps that another browser can repeat, and the links that carry them.
//
// A step is {make: fields of a request}, {change: parameters of a change} or {pick: number of a sample}. A step that needs
// a motion takes the sample `from` of the step before it.

import { readMotion } from "./server.js";
import { makeTake } from "./session.js";

const MOST_STEPS = 50;
const PREFIX = "#make=";
const DAMAGED = new Error("it is incomplete or damaged");

// Returns the steps of a motion that is made from a sample of a take, or null if the take has none: it is from a file.
export function stepsAfter(take, from, step) {
  const steps = stepsOf(take);
  return steps && [...steps, { ...step, from }];
}

export function stepsOf(take) {
  if (take.steps !== undefined) return take.steps;
  return take.kind === "new" ? [{ make: take.request }] : null; // of an older version of the page
}

// The sample of a take as a take of its own.
export function pickSample(take, number) {
  const motion = take.motions[number];
  const scene = { seconds: motion.seconds, figures: [take.scene.figures[number]] };
  const steps = stepsOf(take);
  return makeTake({
    kind: "selection", request: { ...take.request, num_samples: 1 }, scene, motions: [motion], warning: take.warning, steps: steps && [...steps, { pick: number }],
  });
}

// A motion with changes, as a take of its own.
export async function changeSample(take, number, change) {
  const { npz, seed } = take.motions[number];
  const bytes = Uint8Array.from(atob(npz), (character) => character.charCodeAt(0));
  const { scene, motion } = await readMotion(bytes, change);
  const steps = stepsAfter(take, number, { change });
  return makeTake({ kind: change.split === undefined ? "changed" : "split", request: { ...take.request, seed }, scene, motions: [motion], warning: take.warning, steps });
}

// Returns the address that makes a motion again, or null. It says nothing to the server: what follows # stays in browsers.
export function linkOf(take, selected) {
  const steps = take.kind === "comparison" ? null : stepsOf(take);
  if (!steps) return null;
  const content = selected ? { steps, selected } : { steps };
  return `${location.origin}${location.pathname}${PREFIX}${encodeURIComponent(JSON.stringify(content))}`;
}

// Returns the steps in the address of this page, or null.
export function recipeFromAddress() {
  if (!location.hash.startsWith(PREFIX)) return null;
  const isStep = (step) => [step.make, step.change, step.pick].filter((part) => part !== undefined).length === 1;
  try {
    const { steps, selected = 0 } = JSON.parse(decodeURIComponent(location.hash.slice(PREFIX.length)));
    if (steps.length <= MOST_STEPS && steps.every(isStep) && steps[0].make) return { steps, selected };
  } catch {
    // Programs that pass links on may cut them, or change their signs.
  }
  throw DAMAGED;
}

function kindOf({ span, seconds, strength }) {
  if (span) return seconds === undefined ? "redo" : span[0] === span[1] ? "insert" : "length";
  return strength === undefined ? "continue" : "vary";
}

// Makes a motion again; `make` asks the server for motions. Returns null if the user cancels.
export async function repeat(steps, make) {
  let take = null;
  for (const { make: asked, change, pick, from } of steps) {
    const base = take && { take, from: from ?? 0 };
    if (take && !take.motions[pick ?? base.from]) throw DAMAGED;
    if (pick !== undefined) take = pickSample(take, pick);
    else if (change) take = await changeSample(base.take, base.from, change);
    else take = await make(asked, base ? kindOf(asked) : "new", base);
    if (take === null) return null;
  }
  return take;
}
