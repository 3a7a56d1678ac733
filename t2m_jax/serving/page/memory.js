// What is remembered when the page is left: by this tab, and for tabs that are opened later.

const PREFIX = "t2m-studio-";

const write = (storage, name, value) => {
  try {
    storage().setItem(PREFIX + name, JSON.stringify(value));
  } catch {
    // Storage is forbidden or full: what is written lasts until the page is closed.
  }
};

const read = (storage, name) => {
  try {
    return JSON.parse(storage().getItem(PREFIX + name));
  } catch {
    return null;
  }
};

// Functions, because even to name a forbidden storage raises an error.
const ofTab = () => sessionStorage;
const ofBrowser = () => localStorage;

export function remember(name, value) {
  write(ofTab, name, value);
  write(ofBrowser, name, value);
}

// A tab continues with its own state, and a new one with the newest of all.
export const recall = (name) => read(ofTab, name) ?? read(ofBrowser, name);

// What other tabs have nothing to do with: the values of forms, and the request that this tab waits for.
export const rememberInTab = (name, value) => write(ofTab, name, value);
export const recallInTab = (name) => read(ofTab, name);

const keyOf = (control) => control.dataset.field ?? (control.name || control.id);
const controlsOf = (form) => [...form.elements].filter((control) => control.matches("input, select") && keyOf(control));

function valuesOf(form) {
  const values = {};
  for (const control of controlsOf(form)) {
    if (control.type === "checkbox") values[keyOf(control)] = control.checked;
    else if (control.type !== "radio" || control.checked) values[keyOf(control)] = control.value;
  }
  return values;
}

export function setValues(form, values) {
  for (const control of controlsOf(form)) {
    const value = values[keyOf(control)];
    if (value === undefined) continue;
    if (control.type === "checkbox") control.checked = value;
    else if (control.type === "radio") control.checked = control.value === value;
    else if (control.tagName !== "SELECT" || [...control.options].some((option) => option.value === String(value))) control.value = value;
  }
}

// Gives a form the values that it had when the page was left, and keeps those that it gets.
export function keepForm(form) {
  setValues(form, recallInTab(form.id) ?? {});
  const keep = () => rememberInTab(form.id, valuesOf(form));
  form.addEventListener("input", keep);
  addEventListener("pagehide", keep); // also what the page itself has set
}

// Opens and closes the parts of the page as they were when it was left, and keeps how they are.
export function keepParts() {
  const parts = [...document.querySelectorAll("details")];
  const former = recallInTab("parts") ?? {};
  for (const part of parts) part.open = former[part.id] ?? part.open;
  addEventListener("pagehide", () => rememberInTab("parts", Object.fromEntries(parts.map((part) => [part.id, part.open]))));
}
