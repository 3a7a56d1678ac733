// What was done, so that it can be undone and done again.

import { find, showMessage } from "./dom.js";

const JOINED_MS = 1000; // typing without a longer pause is undone at once

export class UndoStack {
  #done = [];
  #undone = [];
  #running = Promise.resolve(); // a key that is pressed while an action is undone waits for it

  constructor() {
    find("undo").addEventListener("click", () => this.undo());
    find("redo").addEventListener("click", () => this.redo());
    this.#show();
  }

  // Notes an action {name, undo, redo}. Drafts of sentences have `isDraft`; those with the same `key` are joined.
  push(action) {
    const last = this.#done.at(-1);
    const now = performance.now();
    this.#undone = [];
    if (action.key && last?.key === action.key && now - last.at < JOINED_MS) Object.assign(last, { redo: action.redo, at: now });
    else this.#done.push({ ...action, at: now });
    this.#show();
  }

  // What was written has become a motion, whose action restores all of it.
  dropDrafts() {
    this.#done = this.#done.filter((action) => !action.isDraft);
    this.#show();
  }

  get isDraft() {
    return this.#done.at(-1)?.isDraft === true;
  }

  get isUndoneDraft() {
    return this.#undone.at(-1)?.isDraft === true;
  }

  undo() {
    return this.#move(this.#done, this.#undone, "undo");
  }

  redo() {
    return this.#move(this.#undone, this.#done, "redo");
  }

  #move(from, to, verb) {
    this.#running = this.#running.then(() => this.#step(from, to, verb));
    return this.#running;
  }

  async #step(from, to, verb) {
    if (from.length === 0) return;
    const action = from.pop();
    try {
      await action[verb]();
      to.push({ ...action, key: null });
    } catch (error) {
      showMessage(`This cannot be ${verb === "undo" ? "undone" : "done again"}: ${error.message}.`);
    } finally {
      this.#show();
    }
  }

  #show() {
    for (const [id, stack, verb, keys] of [["undo", this.#done, "Undo", "Ctrl+Z"], ["redo", this.#undone, "Redo", "Ctrl+Shift+Z"]]) {
      const button = find(id);
      button.ariaDisabled = String(stack.length === 0); // not `disabled`, which would take the focus away
      button.title = stack.length ? `${verb}: ${stack.at(-1).name} (${keys})` : `Nothing to ${verb.toLowerCase()}`;
    }
  }
}
