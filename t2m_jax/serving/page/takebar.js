// The line above the stage: what is shown, and what can be done with it.

import { find } from "./dom.js";
import { pickSample } from "./recipe.js";
import { sentencesOf } from "./session.js";

export class TakeBar {
  constructor(session, history, { onReuseSeed, onKeep, rename, duplicate, share }) {
    Object.assign(this, { session, history });
    find("reuse-seed").addEventListener("click", () => onReuseSeed(session.motion.seed));
    // The selected one of several candidates becomes a take of its own.
    find("keep-sample").addEventListener("click", () => onKeep(pickSample(session.take, session.selected)));
    find("rename").addEventListener("click", rename);
    find("duplicate").addEventListener("click", duplicate);
    find("share").addEventListener("click", share);
    session.onChange(["take", "select", "history"], () => this.#update());
  }

  #update() {
    const { take, motion } = this.session;
    const entry = this.history.find(take?.id);
    const compared = take?.kind === "comparison";
    find("empty").hidden = motion !== null;
    find("take-actions").hidden = motion === null;
    find("warning").hidden = !take?.warning;
    find("warning").textContent = take?.warning ?? "";
    find("reuse-seed").hidden = compared || !Number.isInteger(motion?.seed);
    find("keep-sample").hidden = compared || (take?.motions.length ?? 0) < 2;
    find("share").hidden = compared;
    for (const id of ["rename", "duplicate"]) find(id).hidden = !entry;
    find("take-title").textContent = this.#title(take, motion, compared, entry);
    find("take-facts").textContent = motion === null ? "" : this.#facts(take, motion);
  }

  #title(take, motion, compared, entry) {
    if (motion === null) return "No motion yet";
    if (compared) return "Comparison";
    return entry?.name || sentencesOf(motion).join(", then ") || take.request.name || "Motion";
  }

  #facts(take, motion) {
    const facts = [`${motion.seconds.toFixed(2)} s`, `${motion.frames} frames`, `${motion.fps} fps`];
    if (take.motions.length > 1) facts.unshift(`${this.session.selected + 1} of ${take.motions.length}`);
    if (Number.isInteger(motion.seed)) facts.push(`seed\u00a0${motion.seed}`);
    return facts.join(" · ");
  }
}
