// The list of all takes. It is kept in the browser; without storage, it lasts until the page is closed.

import { ask, create, find, iconButton, once, showMessage } from "./dom.js";
import { sentencesOf } from "./session.js";
import { Store } from "./store.js";

const KINDS = { new: "", file: "file", continue: "continued", redo: "part redone", vary: "varied", changed: "changed", selection: "chosen" };

export class History {
  #entries = [];
  #loose = new Map(); // takes that could not be stored

  constructor(session, onPin) {
    Object.assign(this, { session, onPin });
    find("delete-all").addEventListener("click", () => this.#deleteAll());
    session.onChange(["take"], () => this.#markCurrent());
  }

  async open() {
    try {
      this.store = await Store.open();
      this.#entries = await this.store.entries();
    } catch {
      showMessage("This browser keeps no history here: motions are lost when the page is closed.");
    }
    this.#draw();
  }

  async add(take) {
    const { id, created, kind, request, motions } = take;
    const [first] = motions;
    const caption = sentencesOf(first).join(", then ") || request.name || "Motion";
    const entry = { id, created, kind, caption, seed: request.seed, numSamples: motions.length, seconds: first.seconds };
    this.#entries.push(entry);
    try {
      if (!this.store) throw new Error("no storage");
      await this.store.add(entry, take);
    } catch (error) {
      this.#loose.set(id, take);
      if (error?.name === "QuotaExceededError") {
        showMessage("The browser's storage is full, so this motion is lost when the page is closed. Delete old ones.");
      }
    }
    this.#draw();
  }

  async take(id) {
    const take = this.#loose.get(id) ?? (await this.store.take(id));
    if (!take) throw new Error("this motion is no longer in the browser's storage");
    return take;
  }

  async #restore(entry) {
    try {
      this.session.show(await this.take(entry.id));
      find("stage-frame").scrollIntoView({ block: "nearest" });
    } catch (error) {
      showMessage(`The motion cannot be shown: ${error.message}.`);
    }
  }

  async #delete(entry) {
    const place = this.#entries.indexOf(entry);
    this.#entries.splice(place, 1);
    this.#loose.delete(entry.id);
    await this.store?.delete(entry.id).catch(() => showMessage("The motion could not be deleted from the storage."));
    this.#draw();
    const rows = find("takes").querySelectorAll(".take-open");
    (rows[rows.length - place] ?? rows[0] ?? find("history-title")).focus();
  }

  async #deleteAll() {
    find("confirm-text").textContent = `Delete all ${this.#entries.length} motions of the history?`;
    if ((await ask(find("confirm"))) !== "yes") return;
    this.#entries = [];
    this.#loose.clear();
    await this.store?.clear().catch(() => showMessage("The history could not be deleted from the storage."));
    this.#draw();
  }

  #draw() {
    this.#entries.sort((a, b) => b.created - a.created);
    find("history-empty").hidden = this.#entries.length > 0;
    find("delete-all").hidden = this.#entries.length === 0;
    find("takes").replaceChildren(...this.#entries.map((entry) => this.#row(entry)));
    this.#markCurrent();
  }

  #markCurrent() {
    for (const row of find("takes").children) {
      row.firstElementChild.ariaCurrent = row.dataset.id === this.session.take?.id ? "true" : null;
    }
  }

  #row(entry) {
    const open = create(
      "button",
      { type: "button", className: "take-open", onclick: () => this.#restore(entry) },
      create("span", { className: "take-caption", dir: "auto", textContent: entry.caption }),
      create("span", { className: "take-meta", textContent: describe(entry) }),
    );
    const name = entry.caption.slice(0, 60);
    const compare = iconButton("compare", `Compare ${name}`, () => this.onPin(entry));
    const remove = iconButton("remove", `Delete ${name}`, once(() => this.#delete(entry)));
    const row = create("li", { className: "take" }, open, compare, remove);
    row.dataset.id = entry.id;
    return row;
  }
}

function describe({ created, kind, seed, numSamples, seconds }) {
  const time = new Date(created);
  const today = time.toDateString() === new Date().toDateString();
  const when = today ? time.toLocaleTimeString([], { timeStyle: "short" }) : time.toLocaleDateString();
  const count = numSamples > 1 ? `${numSamples} samples` : `${seconds.toFixed(1)} s`;
  const facts = [when, KINDS[kind], count, seed === null || seed === undefined ? "" : `seed\u00a0${seed}`];
  return facts.filter(Boolean).join(" · ");
}
