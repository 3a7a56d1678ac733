// The words that the model has learned. A click writes one into the sentence.

import { create, find } from "./dom.js";

export function showWords(model, insert) {
  const actions = new Set(model.actions);
  // Movements come first: they are what a sentence begins with.
  const words = [...model.actions, ...(model.words ?? []).filter((word) => !actions.has(word))];
  const chips = words.map((word) => {
    const className = actions.has(word) ? "chip action" : "chip";
    return create("button", { type: "button", className, textContent: word, onclick: () => insert(word) });
  });
  find("words").append(...chips);
  find("word-count").textContent = `(${words.length})`;
  const filter = () => {
    const part = find("word-filter").value.trim().toLowerCase();
    for (const chip of chips) chip.hidden = !chip.textContent.includes(part);
  };
  find("word-filter").addEventListener("input", filter);
  filter(); // the browser may have kept what was written
}
