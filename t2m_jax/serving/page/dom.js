// Small helpers for elements. Text from users is only ever set as text.

export const find = (id) => document.getElementById(id);

export function create(tag, properties = {}, ...children) {
  const element = Object.assign(document.createElement(tag), properties);
  element.append(...children);
  return element;
}

// Returns a picture of one shape, which screen readers leave out.
export function drawing(shape, attributes) {
  const space = "http://www.w3.org/2000/svg";
  const svg = document.createElementNS(space, "svg");
  const part = document.createElementNS(space, shape);
  for (const [name, value] of Object.entries(attributes)) part.setAttribute(name, value);
  svg.setAttribute("aria-hidden", "true");
  svg.append(part);
  return svg;
}

export const icon = (name) => drawing("use", { href: `#icon-${name}` });

export function iconButton(name, label, action) {
  const button = create("button", { type: "button", className: "icon", title: label, onclick: action }, icon(name));
  button.setAttribute("aria-label", label);
  return button;
}

// Returns an action that ignores the second click of a double click, which may hit what has just come under the pointer.
export const once = (action) => (event) => { if (event.detail < 2) action(); };

export function setIcon(button, name) {
  button.querySelector("use").setAttribute("href", `#icon-${name}`);
}

export function fillSelect(select, choices) {
  select.replaceChildren(...choices.map(([value, text]) => create("option", { value, textContent: text })));
}

export const clamp = (value, low, high) => Math.min(Math.max(value, low), high);

export const seconds = (value) => `${value.toFixed(1)} s`;

export const wantsMotion = () => !matchMedia("(prefers-reduced-motion: reduce)").matches;

// Shows one line about what went wrong, until the user closes it or the next attempt begins.
export function showMessage(text) {
  const box = find("message");
  const close = iconButton("remove", "Close the message", clearMessage);
  clearNotice(); // which is at the same place
  box.replaceChildren(create("p", { textContent: text, dir: "auto" }), close);
}

export function clearMessage() {
  find("message").replaceChildren();
}

const NOTICE_MS = 12_000;
let noticeTimer;

// Shows for some seconds what was done or is being done, and a button for what may follow.
export function showNotice(text, label = null, action = null) {
  clearTimeout(noticeTimer);
  noticeTimer = setTimeout(clearNotice, NOTICE_MS);
  const parts = [create("p", { textContent: text, dir: "auto" })];
  if (label) {
    const run = () => {
      clearNotice();
      action();
    };
    parts.push(create("button", { type: "button", className: "quiet", textContent: label, onclick: once(run) }));
  }
  find("notice").replaceChildren(...parts, iconButton("remove", "Close the notice", clearNotice));
}

export function clearNotice() {
  find("notice").replaceChildren();
}

// Resolves to the value of the button that closed the dialog; it is empty after Escape.
export function ask(dialog) {
  return new Promise((resolve) => {
    dialog.returnValue = "";
    dialog.addEventListener("close", () => resolve(dialog.returnValue), { once: true });
    dialog.showModal();
  });
}
