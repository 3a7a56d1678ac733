// The history: recipes that this browser keeps. A motion is made again from its recipe, unless the page still has it.

import { create, find, iconButton, showNotice } from "../studio/dom.js";
import { captionOf, checkRecipe, sameRecipe } from "./recipe.js";

const KEY = `t2m-page-history ${location.pathname}`;
const MOST = 100; // entries
const MOST_KEPT = 20; // motions in memory

export class Past {
  #entries = [];
  #takes = new Map(); // by recipe

  // `onOpen` gets the recipe of the entry that was chosen.
  constructor(onOpen) {
    this.onOpen = onOpen;
    this.#read();
    find("delete-all").addEventListener("click", () => this.#delete(() => true));
    addEventListener("storage", ({ key }) => key === KEY && this.#read());
  }

  #read() {
    try {
      const stored = JSON.parse(localStorage.getItem(KEY)) ?? [];
      this.#entries = stored.slice(0, MOST).map(checkRecipe);
    } catch {
      this.#entries = []; // storage is forbidden, or another program wrote there
    }
    this.#draw();
  }

  #change(entries) {
    this.#entries = entries.slice(0, MOST);
    try {
      localStorage.setItem(KEY, JSON.stringify(this.#entries));
    } catch {
      // The history lasts until the page is closed.
    }
    this.#draw();
  }

  #delete(isUnwanted) {
    const former = this.#entries;
    this.#change(former.filter((entry) => !isUnwanted(entry)));
    const count = former.length - this.#entries.length;
    showNotice(count > 1 ? `${count} motions are deleted.` : "The motion is deleted.", "Undo", () => this.#change(former));
    find("history-title").focus(); // the button is gone
  }

  // Puts a take first.
  add(take) {
    this.#takes.set(JSON.stringify(take.request), take);
    if (this.#takes.size > MOST_KEPT) this.#takes.delete(this.#takes.keys().next().value);
    this.current = take.request;
    this.#change([take.request, ...this.#entries.filter((entry) => !sameRecipe(entry, take.request))]);
  }

  // Returns the take of a recipe if it is still in memory.
  takeOf(recipe) {
    return this.#takes.get(JSON.stringify(recipe));
  }

  #rowOf(recipe) {
    const about = `seed ${recipe.seed}${recipe.samples > 1 ? ` · ${recipe.samples} samples` : ""}`;
    const open = create(
      "button",
      { type: "button", className: "take-open", title: captionOf(recipe), onclick: () => this.onOpen(recipe) },
      create("span", { className: "take-caption", dir: "auto", textContent: captionOf(recipe) }),
      create("span", { className: "take-meta", textContent: about }),
    );
    if (this.current && sameRecipe(recipe, this.current)) open.ariaCurrent = "true";
    const remove = iconButton("remove", `Delete ${captionOf(recipe).slice(0, 60)}, ${about}`, () => this.#delete((entry) => sameRecipe(entry, recipe)));
    return create("li", { className: "take" }, open, remove);
  }

  #draw() {
    find("takes").replaceChildren(...this.#entries.map((recipe) => this.#rowOf(recipe)));
    find("history-empty").hidden = this.#entries.length > 0;
    find("delete-all").hidden = this.#entries.length === 0;
  }
}
