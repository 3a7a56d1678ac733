// Controls for the fields of requests, made from the JSON schemas that the server gives, so that limits and choices are its own.

import { create, fillSelect } from "./dom.js";

const LABELS = {
  guidance_scale: "Text strength",
  raw: "Not cleaned",
  whole: "Sentence as it is",
  speed: "Speed factor",
  turn: "Turn, degrees",
  path: "Path in meters",
  clean: "Cleaned",
  mirror: "Mirrored",
  fps: "Frames per second",
  loop: "As a loop",
  in_place: "In place, without travel",
  names: "Joint names",
  targets: "As a text, in seconds and meters",
};
const PLACEHOLDERS = { path: "0,0 1,2 3,2", targets: "2 right_wrist=-0.3,1.7,0.2; 4 root=1,3", fps: "as it is", speed: "1", turn: "0" };

// A field that may be null has its schema in `anyOf`.
export const plain = (schema) => ({ ...schema, ...schema.anyOf?.[0] });

function makeControl(name, schema) {
  if (schema.enum) {
    const select = create("select");
    fillSelect(select, [["", "Automatic"], ...schema.enum.map((value) => [value, value])]);
    return select;
  }
  if (schema.type === "boolean") return create("input", { type: "checkbox" });
  const placeholder = PLACEHOLDERS[name] ?? String(schema.default ?? "automatic");
  if (schema.type === "string") return create("input", { type: "text", placeholder, autocomplete: "off" });
  const { minimum, exclusiveMinimum, maximum, multipleOf } = schema;
  const input = create("input", { type: "number", placeholder, inputMode: "decimal", step: multipleOf ?? "any" });
  // HTML has no limit that is itself excluded: see `isTooSmall`.
  if (exclusiveMinimum !== undefined) input.dataset.above = exclusiveMinimum;
  return Object.assign(input, { min: minimum ?? exclusiveMinimum ?? "", max: maximum ?? "" });
}

function makeField(name, given) {
  const schema = plain(given);
  const control = makeControl(name, schema);
  Object.assign(control.dataset, { field: name, made: "" });
  const label = create("span", { textContent: LABELS[name] ?? schema.title.replace(/ (.)/g, (_, letter) => ` ${letter.toLowerCase()}`) });
  const isCheck = schema.type === "boolean";
  const children = isCheck ? [control, label] : [label, control];
  return create("label", { className: isCheck ? "check" : "field", title: schema.description }, ...children);
}

// Puts fields at their places in a form. Those that the page does not know yet come to the end of `rest`.
export function makeFields(form, schemas, rest) {
  for (const place of form.querySelectorAll("[data-make]")) {
    const field = makeField(place.dataset.make, schemas[place.dataset.make]);
    Object.assign(field.dataset, place.dataset);
    if (place.className) field.classList.add(place.className);
    place.replaceWith(field);
  }
  for (const [name, schema] of Object.entries(schemas)) {
    if (!document.querySelector(`[data-field~=${name}]`)) rest.append(makeField(name, schema));
  }
}

export const findField = (name) => document.querySelector(`[data-field~="${name}"]`);

export function showField(name, visible) {
  findField(name).closest("label").hidden = !visible;
}

const madeControls = (part) => [...part.querySelectorAll("[data-made]")].filter((control) => !control.closest("label").hidden);

// Returns the values that the user has given.
export function readFields(part) {
  const given = madeControls(part).filter((control) => (control.type === "checkbox" ? control.checked : control.value.trim() !== ""));
  return Object.fromEntries(given.map((control) => {
    const values = { checkbox: true, number: Number(control.value) };
    return [control.dataset.field, values[control.type] ?? control.value.trim()];
  }));
}

export function clearFields(part) {
  for (const control of madeControls(part)) Object.assign(control, { value: "", checked: false });
}

const isTooSmall = ({ valueAsNumber, dataset }) => valueAsNumber <= dataset.above;

// Returns the first control whose value the server would refuse, or undefined.
export const wrongField = (part) => madeControls(part).find((control) => !control.validity.valid || isTooSmall(control));

// Returns a message of the server, which names a field as programs do, with the field's name on the screen.
export function labeled(message) {
  const [, name, reason] = /^(?:request: |parameters: )?(\w+): (.*)$/s.exec(message) ?? [];
  const label = name && findField(name)?.closest("label");
  if (!label) return message;
  const shown = name === "targets" ? "Targets" : (label.querySelector("span") ?? label).firstChild.textContent.trim();
  return `${shown}: ${reason}`;
}

export function complaint(control) {
  const name = control.getAttribute("aria-label") ?? control.closest("label").textContent;
  return `${name}: ${control.validationMessage || `Value must be greater than ${control.dataset.above}.`}`;
}
