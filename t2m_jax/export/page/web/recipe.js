// What a motion is made of: {sentence, seed, samples, temperature, guidance}; each line of `sentence` is a sentence. The form,
// links and the history use it.

import { cleanSentence } from "./sentence.js";

export const MOST_SAMPLES = 8;
const MOST_SEED = 2 ** 32 - 1;
const PREFIX = "#make?";

function numberOf(text, name, { low, high, whole = false }) {
  const value = Number(text);
  const isRight = String(text).trim() !== "" && Number.isFinite(value) && value >= low && value <= high && (!whole || Number.isInteger(value));
  if (!isRight) throw new Error(`${name} must be a ${whole ? "whole " : ""}number from ${low} to ${high}`);
  return value;
}

function cleanLines(text) {
  const lines = text.split("\n").filter((line) => line.trim() !== "");
  return (lines.length ? lines : [""]).map(cleanSentence).join("\n");
}

export const sentencesOf = (recipe) => recipe.sentence.split("\n");
export const captionOf = (recipe) => sentencesOf(recipe).join(", then ");

// Returns a recipe with checked values. Without a seed, one is drawn; `guidance` is null for models that have none.
export function checkRecipe({ sentence, seed, samples, temperature, guidance }) {
  return {
    sentence: cleanLines(String(sentence)),
    seed: String(seed).trim() === "" ? crypto.getRandomValues(new Uint32Array(1))[0] : numberOf(seed, "the seed", { low: 0, high: MOST_SEED, whole: true }),
    samples: numberOf(samples, "the number of samples", { low: 1, high: MOST_SAMPLES, whole: true }),
    temperature: numberOf(temperature, "the temperature", { low: 0, high: 5 }),
    guidance: guidance === null ? null : numberOf(guidance, "the text strength", { low: 0, high: 20 }),
  };
}

export const sameRecipe = (a, b) => JSON.stringify(a) === JSON.stringify(b);

export function linkOf(recipe) {
  const given = Object.entries(recipe).filter(([, value]) => value !== null);
  return `${location.origin}${location.pathname}${PREFIX}${new URLSearchParams(given)}`;
}

// Returns the recipe in the address of this page, or null. What it lacks is in `usual`.
export function recipeFromAddress(usual) {
  if (!location.hash.startsWith(PREFIX)) return null;
  const given = new URLSearchParams(location.hash.slice(PREFIX.length));
  const fields = Object.keys(usual).filter((name) => usual[name] !== null && given.has(name));
  return checkRecipe({ ...usual, ...Object.fromEntries(fields.map((name) => [name, given.get(name)])) });
}
