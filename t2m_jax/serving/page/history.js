// The list of all takes. It is kept in the browser; without storage, it lasts until the page is closed.

import { ask, create, drawing, find, iconButton, once, showMessage, showNotice } from "./dom.js";
import { stepsOf } from "./recipe.js";
import { makeTake, sentencesOf } from "./session.js";
import { Store } from "./store.js";

const KINDS = { new: "", file: "file", continue: "continued", insert: "inserted", length: "new length", split: "split", redo: "part redone", vary: "varied", changed: "changed", selection: "chosen", copy: "copy" };
// Made once: to make one takes longer than to draw a row.
const CLOCK = new Intl.DateTimeFormat([], { timeStyle: "short" });
const CALENDAR = new Intl.DateTimeFormat();
const [WIDTH, HEIGHT] = [72, 34]; // pixels of the picture of a motion
const TABS = "t2m-studio-tabs";
const DELETED_FOR = 3_600_000; // milliseconds for which a deleted motion can come back

export class History {
  #entries = [];
  #loose = new Map(); // takes that could not be stored
  #rows = new Map(); // by entry; those that do not change stay in the page
  #tabs = new BroadcastChannel("t2m-studio-history");

  constructor(session, undo, onPin) {
    Object.assign(this, { session, undo, onPin });
    find("delete-all").addEventListener("click", () => this.#deleteAll());
    session.onChange(["take"], () => this.#markCurrent());
    this.#tabs.onmessage = () => this.#read();
  }

  async open() {
    try {
      this.store = await Store.open();
      const all = await this.store.entries();
      const isOld = ({ deleted }) => deleted && Date.now() - deleted > DELETED_FOR;
      if (await isOnlyTab()) await this.store.delete(all.filter(isOld)); // another tab may bring them back
      await this.#read();
    } catch {
      showMessage("This browser keeps no history here: motions are lost when the page is closed.");
      this.#draw();
    }
  }

  get #listed() {
    return this.#entries.filter(({ deleted }) => !deleted);
  }

  get newest() {
    return this.#listed.at(-1);
  }

  find(id) {
    return this.#listed.find((entry) => entry.id === id);
  }

  async add(take, { name } = {}) {
    const { id, created, kind, request, motions } = take;
    const [first] = motions;
    const caption = sentencesOf(first).join(", then ") || request.name || "Motion";
    const picture = T2M.drawMiniature(take.scene.figures[0], WIDTH, HEIGHT);
    const entry = { id, created, kind, caption, name, picture, seed: request.seed, numSamples: motions.length, seconds: first.seconds };
    this.#entries = [...this.#entries.filter((one) => one.id !== id), entry];
    try {
      if (!this.store) throw new Error("no storage");
      await this.#store(entry, take);
    } catch (error) {
      this.#loose.set(id, take);
      if (error?.name === "QuotaExceededError") {
        showMessage("The browser's storage is full, so this motion is lost when the page is closed. Delete old ones.");
      }
    }
    this.#changed();
  }

  // Deleted motions still have their room until it is needed.
  async #store(entry, take) {
    try {
      await this.store.add(entry, take);
    } catch (error) {
      const deleted = this.#entries.filter((one) => one.deleted);
      if (error?.name !== "QuotaExceededError" || deleted.length === 0) throw error;
      await this.store.delete(deleted);
      this.#entries = this.#listed;
      await this.store.add(entry, take);
    }
  }

  async take(id) {
    const take = this.#loose.get(id) ?? (await this.store?.take(id));
    if (!take) throw new Error("this motion is no longer in the browser's storage");
    return take;
  }

  // Returns the newest motion that was made in the same steps, or null.
  async findMade(steps) {
    const { seed } = steps.findLast(({ make }) => make).make;
    for (const entry of this.#listed.reverse().filter((one) => one.seed === seed)) {
      const take = await this.take(entry.id).catch(() => null);
      if (JSON.stringify(take && stepsOf(take)) === JSON.stringify(steps)) return take;
    }
    return null;
  }

  // Changes entries, which tells other tabs; `deleted` is a time, or null.
  async change(ids, fields) {
    const changed = this.#entries.filter(({ id }) => ids.includes(id));
    if (changed.length < ids.length) throw new Error("this motion is no longer in the history");
    // Another tab may have made room.
    const isThere = async (id) => this.#loose.has(id) || (await this.store?.has(id));
    if (fields.deleted === null && !(await Promise.all(ids.map(isThere))).every(Boolean)) {
      throw new Error("this motion is no longer in the browser's storage");
    }
    for (const entry of changed) Object.assign(entry, fields);
    const stored = changed.filter(({ id }) => !this.#loose.has(id));
    await this.store?.change(stored).catch(() => showMessage("The history could not be changed in the browser's storage."));
    this.#changed();
  }

  delete(ids, name) {
    const action = {
      name,
      undo: () => this.change(ids, { deleted: null }),
      redo: () => this.change(ids, { deleted: Date.now() }),
    };
    this.undo.push(action);
    showNotice(ids.length > 1 ? `${ids.length} motions are deleted.` : "The motion is deleted.", "Undo", () => this.undo.undo());
    return action.redo();
  }

  async rename(entry) {
    const input = find("new-name");
    input.value = entry.name ?? entry.caption;
    if ((await ask(find("rename-dialog"))) !== "yes") return;
    const [before, name] = [entry.name, input.value.trim() || undefined];
    const action = { name: "rename", undo: () => this.change([entry.id], { name: before }), redo: () => this.change([entry.id], { name }) };
    await action.redo();
    this.undo.push(action);
  }

  async duplicate(entry) {
    const original = await this.take(entry.id);
    const take = makeTake({ ...original, id: undefined, kind: "copy", steps: stepsOf(original) });
    await this.add(take, { name: `${entry.name ?? entry.caption} (copy)` });
    this.undo.push({
      name: "duplicate",
      undo: () => this.change([take.id], { deleted: Date.now() }),
      redo: () => this.change([take.id], { deleted: null }),
    });
    return take;
  }

  async #show(entry) {
    try {
      this.session.show(await this.take(entry.id));
      find("stage-frame").scrollIntoView({ block: "nearest" });
    } catch (error) {
      showMessage(`The motion cannot be shown: ${error.message}.`);
    }
  }

  async #deleteOne(entry) {
    const place = this.#listed.indexOf(entry);
    await this.delete([entry.id], "delete");
    const rows = find("takes").querySelectorAll(".take-open");
    (rows[rows.length - place] ?? rows[0] ?? find("history-title")).focus();
  }

  async #deleteAll() {
    const ids = this.#listed.map(({ id }) => id);
    find("confirm-text").textContent = `Delete all ${ids.length} motions of the history?`;
    if ((await ask(find("confirm"))) === "yes") await this.delete(ids, "delete all");
  }

  #changed() {
    this.#tabs.postMessage(null);
    this.#draw();
  }

  // Another tab may have changed the storage.
  async #read() {
    const loose = this.#entries.filter(({ id }) => this.#loose.has(id));
    this.#entries = [...(await this.store?.entries() ?? []), ...loose];
    this.#draw();
  }

  #draw() {
    this.#entries.sort((a, b) => a.created - b.created);
    const listed = this.#listed.reverse();
    find("history-empty").hidden = listed.length > 0;
    find("delete-all").hidden = listed.length === 0;
    this.#drawRows(listed);
    this.#markCurrent();
    this.session.dispatchEvent(new Event("history"));
  }

  #drawRows(listed) {
    const former = this.#rows;
    this.#rows = new Map(listed.map((entry) => [entry.id, this.#rowOf(entry, former.get(entry.id))]));
    const rows = [...this.#rows.values()];
    for (const row of former.values()) if (this.#rows.get(row.dataset.id) !== row) row.remove();
    rows.forEach((row, place) => {
      const there = find("takes").children[place];
      if (there !== row) find("takes").insertBefore(row, there ?? null);
    });
  }

  #markCurrent() {
    for (const row of find("takes").children) {
      row.firstElementChild.ariaCurrent = row.dataset.id === this.session.take?.id ? "true" : null;
    }
  }

  // Returns the row of an entry: the former one if it says the same.
  #rowOf({ id, name, caption, picture, ...entry }, former) {
    const title = name ?? caption;
    const about = describe(entry);
    if (former?.dataset.shown === `${title}\n${about}`) return former;
    const open = create(
      "button",
      { type: "button", className: "take-open", title: caption, onclick: () => this.#show(this.find(id)) },
      miniature(picture),
      create("span", { className: "take-caption", dir: "auto", textContent: title }),
      create("span", { className: "take-meta", textContent: about }),
    );
    const short = title.slice(0, 60);
    const compare = iconButton("compare", `Compare ${short}`, () => this.onPin(this.find(id)));
    const remove = iconButton("remove", `Delete ${short}`, once(() => this.#deleteOne(this.find(id))));
    const row = create("li", { className: "take" }, open, compare, remove);
    row.addEventListener("keydown", (event) => {
      if (event.key !== "Delete") return;
      event.stopPropagation(); // elsewhere, the key deletes the motion that is shown
      remove.click();
    });
    Object.assign(row.dataset, { id, shown: `${title}\n${about}` });
    return row;
  }
}

// Returns whether no other tab shows the studio; where browsers cannot tell, no. This tab then counts for others.
async function isOnlyTab() {
  if (!navigator.locks) return false;
  const isOnly = await navigator.locks.request(TABS, { ifAvailable: true }, (lock) => lock !== null);
  navigator.locks.request(TABS, { mode: "shared" }, () => new Promise(() => {}));
  return isOnly;
}

// Motions of earlier versions have no picture.
function miniature(picture = "") {
  const svg = drawing("path", { d: picture });
  svg.setAttribute("viewBox", `0 0 ${WIDTH} ${HEIGHT}`);
  svg.setAttribute("class", "take-picture");
  return svg;
}

// The seed is above the stage; ten digits have no room here.
function describe({ created, kind, numSamples, seconds }) {
  const isToday = new Date(created).toDateString() === new Date().toDateString();
  const when = (isToday ? CLOCK : CALENDAR).format(created);
  const count = numSamples > 1 ? `${numSamples}\u00a0samples` : `${seconds.toFixed(1)}\u00a0s`;
  return [when, KINDS[kind], count].filter(Boolean).join(" · ");
}
