// The line above the stage: what is shown, and what can be done with it.

import { find } from "./dom.js";
import { makeTake, sentencesOf } from "./session.js";

export class TakeBar {
  constructor(session, { onReuseSeed, onKeep }) {
    this.session = session;
    find("reuse-seed").addEventListener("click", () => onReuseSeed(session.motion.seed));
    find("keep-sample").addEventListener("click", () => onKeep(this.#selectedAlone()));
    session.onChange(["take", "select"], () => this.#update());
  }

  // The selected one of several candidates, as a take of its own.
  #selectedAlone() {
    const { take, motion, selected } = this.session;
    const scene = { seconds: motion.seconds, figures: [take.scene.figures[selected]] };
    return makeTake({ kind: "selection", request: { ...take.request, num_samples: 1 }, scene, motions: [motion], warning: take.warning });
  }

  #update() {
    const { take, motion } = this.session;
    const compared = take?.kind === "comparison";
    find("empty").hidden = motion !== null;
    find("take-actions").hidden = motion === null;
    find("warning").hidden = !take?.warning;
    find("warning").textContent = take?.warning ?? "";
    find("reuse-seed").hidden = compared || !Number.isInteger(motion?.seed);
    find("keep-sample").hidden = compared || (take?.motions.length ?? 0) < 2;
    find("take-title").textContent = this.#title(take, motion, compared);
    find("take-facts").textContent = motion === null ? "" : this.#facts(take, motion);
  }

  #title(take, motion, compared) {
    if (motion === null) return "No motion yet";
    if (compared) return "Comparison";
    return sentencesOf(motion).join(", then ") || take.request.name || "Motion";
  }

  #facts(take, motion) {
    const facts = [`${motion.seconds.toFixed(2)} s`, `${motion.frames} frames`, `${motion.fps} fps`];
    if (take.motions.length > 1) facts.unshift(`${this.session.selected + 1} of ${take.motions.length}`);
    if (Number.isInteger(motion.seed)) facts.push(`seed ${motion.seed}`);
    return facts.join(" · ");
  }
}
