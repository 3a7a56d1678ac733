// Where joints should be at a time. The text of a field is the only place where they are kept: what the user types, drags
// or deletes changes it, and all else is drawn from it.

const FORM = /^([^\s:]+)(?::(\S+))? (\w+) ?(\+?=) ?(\S.*?)( exact)?$/; // with single spaces, which no text makes slow
export const ROOT = "root";
export const FACING = "facing";
export const POSE = "pose";
const PLACES = { [ROOT]: ["x", "z"], [FACING]: ["degrees"], [POSE]: [] };
const NAMES = { [ROOT]: "Root on the ground", [FACING]: "Direction", [POSE]: "Pose" };

// Names of the numbers of a target that can be typed; a pose has too many.
export const placesOf = ({ joint }) => PLACES[joint] ?? ["x", "y", "z"];

const numberOf = (text) => (text?.trim() ? Number(text) : NaN);

// Returns {seconds, until, joint, sign, place, exact} of a text; of one that cannot be read, {text}.
export function readTarget(text) {
  const [, begin, until, joint, sign, numbers, exact] = FORM.exec(text.trim().replace(/\s+/g, " ")) ?? [];
  const place = (numbers ?? "").split(",").map(numberOf);
  const seconds = numberOf(begin);
  const isWhole = joint === POSE ? place.length % 3 === 0 : place.length === placesOf({ joint }).length;
  const isRead = isWhole && [seconds, ...place, until === undefined ? 0 : numberOf(until)].every(Number.isFinite);
  return isRead ? { seconds, until, joint, sign, place, exact: exact !== undefined } : { text: text.trim() };
}

export function textOf({ text, seconds, until, joint, sign, place, exact }) {
  return text ?? `${seconds}${until ? `:${until}` : ""} ${joint}${sign}${place.join(",")}${exact ? " exact" : ""}`;
}

export function nameOf({ text, joint }) {
  const words = (joint ?? "").replaceAll("_", " ");
  return text ?? NAMES[joint] ?? words.charAt(0).toUpperCase() + words.slice(1);
}

const readAll = (text) => text.split(";").filter((part) => part.trim()).map(readTarget);

// Returns the text of those targets that are in a span of seconds.
export function targetsIn(text, [begin, end]) {
  const inside = ({ seconds, until }) => seconds >= begin && Number(until ?? seconds) < end;
  return readAll(text).filter((item) => item.text !== undefined || inside(item)).map(textOf).join("; ");
}

export const rounded = (number) => Number(number.toFixed(2)) + 0; // no minus zero

export class Targets extends EventTarget {
  #kept; // the text before a change that is not finished
  items = [];
  selected = -1;

  constructor(field, session, undo) {
    super();
    Object.assign(this, { field, session, undo });
    this.#kept = field.value;
    field.addEventListener("input", () => this.#read());
    field.addEventListener("change", () => this.keep());
    field.addEventListener("filled", () => (this.#kept = field.value)); // by the page, which is no step of undo
    session.onChange(["take", "select"], () => this.#tell());
    this.#read();
  }

  // Adds a target, or puts it in place of another, without a step of undo before `keep`. Returns its number.
  put(item, number = this.items.length) {
    this.selected = number;
    const items = [...this.items];
    items[number] = item;
    this.#write(items);
    return number;
  }

  // Makes the changes since the last call one step of undo; those with the same `key` that follow each other quickly are one.
  keep(key = null) {
    const [before, after] = [this.#kept, this.field.value];
    if (before === after) return;
    this.#kept = after;
    this.undo.push({ name: "targets", key, undo: () => this.#restore(before), redo: () => this.#restore(after) });
  }

  remove(number) {
    this.selected = -1;
    this.#write(this.items.filter((_, place) => place !== number));
    this.keep();
  }

  select(number) {
    this.selected = number;
    this.#tell();
  }

  // Returns the number of the target of a joint at a time, or -1.
  find(joint, seconds) {
    return this.items.findIndex((item) => item.joint === joint && Math.abs(item.seconds - seconds) < 0.01);
  }

  // Returns how far the motion that is shown is from a target, {distance, unit, met}; undefined if it had no such target.
  resultOf(item) {
    const { take, motion } = this.session;
    const asked = readAll(take?.request.targets ?? "").map(textOf);
    return motion?.targets?.[asked.indexOf(textOf(item))];
  }

  // What is said of it: "met, 0.4 cm away"; "" if the motion that is shown had no such target.
  verdictOf(item) {
    const { distance, unit, met } = this.resultOf(item) ?? {};
    if (met === undefined) return "";
    const far = unit === "m" ? `${(100 * distance).toFixed(1)} cm` : `${distance.toFixed(0)}°`;
    return met ? `met, ${far} away` : `missed by ${far}`;
  }

  #restore(text) {
    this.#kept = text;
    this.#write(readAll(text));
  }

  #write(items) {
    this.field.value = items.map(textOf).join("; ");
    this.field.dispatchEvent(new Event("input", { bubbles: true })); // which reads it, and the form remembers it
  }

  #read() {
    this.items = readAll(this.field.value);
    if (this.selected >= this.items.length) this.selected = -1;
    this.#tell();
  }

  #tell() {
    this.dispatchEvent(new Event("change"));
  }
}
