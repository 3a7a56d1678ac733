// Keys that work wherever nothing is written.

import { find } from "./dom.js";

const TURN = 25; // pixels of a drag with the mouse
const ZOOM = 1.2;
const isWriting = (element) => element.matches("textarea, select, input:not([type=range], [type=checkbox], [type=radio])");

export function listenForKeys({ player, timeline, session, stage, make, generation, comparison }) {
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
    "/": () => make.sentences.focus(),
    "?": () => find("help").showModal(),
    Escape: () => generation.cancel(),
  };
  for (let number = 1; number <= 9; number += 1) actions[number] = () => session.select(number - 1);

  document.addEventListener("keydown", (event) => {
    const { target } = event;
    if (event.ctrlKey || event.metaKey || event.altKey || event.defaultPrevented || target.closest("dialog")) return;
    if (event.key !== "Escape" && isWriting(target)) return;
    if (event.key === " " && target.closest("button, summary, input")) return; // the browser presses it
    if (target.matches("input[type=range], input[type=radio]") && target.id !== "scrub" && /^Arrow|Home|End/.test(event.key)) return;
    const action = actions[event.key.length === 1 ? event.key.toLowerCase() : event.key];
    if (!action) return;
    event.preventDefault();
    action(event.shiftKey ? 10 : 1);
  });
}
