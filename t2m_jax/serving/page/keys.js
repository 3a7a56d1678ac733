// Keys that work wherever nothing is written.

import { find } from "./dom.js";

const TURN = 25; // pixels of a drag with the mouse
const ZOOM = 1.2;
const isWriting = (element) => element.matches("textarea, select, input:not([type=range], [type=checkbox], [type=radio])");
// A dialog that was just closed keeps the focus until the next frame, so a quick key still arrives there.
const targetOf = (event) => (event.target.closest("dialog:not([open])") ? document.body : event.target);

// Ctrl+Z and its opposites. In a sentence, they only concern what is written.
function undoKey(event, undo) {
  const { key, shiftKey } = event;
  const target = targetOf(event);
  const letter = key.toLowerCase();
  const verb = letter === "z" && !shiftKey ? "undo" : letter === "y" || letter === "z" ? "redo" : null;
  if (verb === null || event.altKey || target.closest("dialog")) return;
  if (isWriting(target) && !(target.closest("#sentences") && (verb === "undo" ? undo.isDraft : undo.isUndoneDraft))) return;
  event.preventDefault();
  undo[verb]();
}

const isFull = () => document.body.classList.contains("full");
let isChanging = false;

// The browser takes a moment to enter or leave the full screen, in which the user may have changed their mind.
async function followFullScreen() {
  if (isChanging) return;
  isChanging = true;
  let isFilled = Boolean(document.fullscreenElement);
  while (isFilled !== isFull()) {
    isFilled = !isFilled;
    // Where a page may not fill the screen, it fills the window.
    await (isFilled ? document.documentElement.requestFullscreen?.() : document.exitFullscreen())?.catch(() => {});
  }
  isChanging = false;
}

export function toggleFullScreen() {
  find("full-screen").setAttribute("aria-pressed", String(document.body.classList.toggle("full")));
  followFullScreen();
}

export function listenForKeys({ player, timeline, session, stage, make, generation, comparison, undo, drawing, actions: todo }) {
  const here = () => stage.time;
  const actions = {
    " ": () => player.toggle(),
    ArrowLeft: (stride) => player.step(-stride),
    ArrowRight: (stride) => player.step(stride),
    Home: () => player.seek(0),
    End: () => player.seek(player.lastFrame),
    "[": () => timeline.setSide(0, here()),
    "]": () => timeline.setSide(1, here() + 1 / player.fps), // the frame that is shown belongs to the span
    "\\": () => session.setSpan(null),
    f: () => player.toggleFollow(),
    ",": () => stage.turn(-TURN),
    ".": () => stage.turn(TURN),
    "+": () => stage.zoom(ZOOM),
    "-": () => stage.zoom(1 / ZOOM),
    r: () => stage.resetView(),
    c: () => comparison.toggleSelected(),
    o: () => comparison.toggleView(),
    p: () => drawing.toggle(),
    m: toggleFullScreen,
    n: todo.rename,
    d: todo.duplicate,
    s: todo.split,
    i: () => make.insertSentence(),
    l: todo.share,
    Delete: todo.delete,
    "/": () => make.sentences.focus(),
    "?": () => find("help").showModal(),
    Escape: () => (drawing.isOn ? drawing.stop() : isFull() ? toggleFullScreen() : generation.cancel()),
  };
  for (let number = 1; number <= 9; number += 1) actions[number] = () => session.select(number - 1);

  document.addEventListener("keydown", (event) => {
    const target = targetOf(event);
    if ((event.ctrlKey || event.metaKey) && !event.defaultPrevented) undoKey(event, undo);
    if (event.ctrlKey || event.metaKey || event.altKey || event.defaultPrevented || target.closest("dialog")) return;
    if (event.key !== "Escape" && isWriting(target)) return;
    if (event.key === " " && target.closest("button, summary, input")) return; // the browser presses it
    if (target.matches("input[type=range], input[type=radio]") && target.id !== "scrub" && /^Arrow|Home|End/.test(event.key)) return;
    const action = actions[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!action) return;
    event.preventDefault();
    action(event.shiftKey ? 10 : 1);
  });

  find("full-screen").addEventListener("click", toggleFullScreen);
  // The browser leaves the full screen by itself after Escape.
  document.addEventListener("fullscreenchange", () => {
    if (!isChanging && !document.fullscreenElement && isFull()) toggleFullScreen();
  });
}
