// The list of sentences of a request; several follow each other on one timeline.

import { create, iconButton, once } from "./dom.js";

// `onInput` gets the place of the sentence that was typed in, or null after another change.
export class SentenceList {
  #fixed = false;

  constructor(list, addButton, { limit, onSubmit, onInput }) {
    Object.assign(this, { list, addButton, limit, onSubmit, onInput });
    addButton.addEventListener("click", () => {
      this.#append("").focus();
      this.#update();
      onInput(null);
    });
    this.values = [""];
  }

  get values() {
    return this.#areas.map((area) => area.value);
  }

  // The fields stay, because the page shows other sentences while one gets the focus, or has it.
  set values(texts) {
    const { place } = this;
    const shown = texts.slice(0, this.limit);
    for (const area of this.#areas.slice(shown.length)) area.parentElement.remove();
    const areas = this.#areas;
    shown.forEach((text, number) => {
      const area = areas[number] ?? this.#append("");
      if (area.value !== text) area.value = text; // or the cursor would move to the end
    });
    this.#update();
    if (place >= shown.length) this.focus();
  }

  // Some requests take as many sentences as there are.
  set fixed(value) {
    this.#fixed = value;
    this.#update();
  }

  get #areas() {
    return [...this.list.querySelectorAll("textarea")];
  }

  focus() {
    this.#areas.at(-1).focus();
  }

  // The place of the sentence that is being written, or -1.
  get place() {
    return this.#areas.indexOf(document.activeElement);
  }

  selectText() {
    this.focus();
    this.#areas.at(-1).select();
  }

  // Inserts a word where the user last wrote.
  insert(word) {
    const area = this.#areas.includes(this.last) ? this.last : this.#areas.at(-1);
    const before = area.value.slice(0, area.selectionStart);
    const gap = before && !/\s$/.test(before) ? " " : "";
    area.setRangeText(gap + word, area.selectionStart, area.selectionEnd, "end");
    area.focus();
    this.onInput(null);
  }

  #append(text) {
    const area = create("textarea", { value: text, rows: 2, dir: "auto", spellcheck: false });
    area.addEventListener("focus", () => { this.last = area; });
    area.addEventListener("input", () => this.onInput(this.#areas.indexOf(area)));
    area.addEventListener("keydown", (event) => {
      if (event.key !== "Enter" || event.shiftKey || event.isComposing) return;
      event.preventDefault();
      this.onSubmit();
    });
    const item = create("li", { className: "sentence" }, area);
    const tools = create(
      "div",
      { className: "sentence-tools" },
      iconButton("up", "Move up", () => this.#move(item, -1)),
      iconButton("down", "Move down", () => this.#move(item, 1)),
      iconButton("remove", "Remove", once(() => this.#remove(item))),
    );
    item.append(tools);
    this.list.append(item);
    return area;
  }

  #move(item, step) {
    if (step < 0) item.previousElementSibling.before(item);
    else item.nextElementSibling.after(item);
    this.#update();
    item.querySelector("textarea").focus();
    this.onInput(null);
  }

  #remove(item) {
    const neighbor = item.previousElementSibling ?? item.nextElementSibling;
    item.remove();
    this.#update();
    neighbor.querySelector("textarea").focus();
    this.onInput(null);
  }

  #update() {
    const items = [...this.list.children];
    this.list.classList.toggle("several", items.length > 1);
    this.list.classList.toggle("fixed", this.#fixed);
    this.addButton.hidden = this.#fixed || items.length >= this.limit;
    items.forEach((item, number) => {
      const area = item.querySelector("textarea");
      const [up, down, remove] = item.querySelectorAll("button");
      const name = items.length > 1 ? `Sentence ${number + 1}` : "Sentence";
      area.setAttribute("aria-label", name);
      area.placeholder = number === 0 ? "a person walks forward" : "then …";
      up.disabled = number === 0;
      down.disabled = number === items.length - 1;
      up.setAttribute("aria-label", `Move ${name} up`);
      down.setAttribute("aria-label", `Move ${name} down`);
      remove.setAttribute("aria-label", `Remove ${name}`);
    });
  }
}
