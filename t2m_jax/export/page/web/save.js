// Files of the selected motion.

import { create, find } from "../studio/dom.js";
import { fileName, saveBlob } from "../studio/savefile.js";
import { arrayFile, textFile, zipFile } from "./archive.js";
import { framesOf } from "./figure.js";
import { animatedFigure } from "./glb.js";

// Returns the motion as Python reads it: `t2m view motion.npz -o motion.bvh` makes any other format of it.
function archiveOf({ positions, codes, caption, seed, frames, fps }, { joints, skeleton }) {
  return zipFile({
    "positions.npy": arrayFile("<f4", [frames, joints.length, 3], positions),
    "codes.npy": arrayFile("<i4", [codes.length, codes[0].length], Int32Array.from(codes.flat())),
    "fps.npy": arrayFile("<f8", [], Float64Array.of(fps)),
    "seed.npy": arrayFile("<i8", [], BigInt64Array.of(BigInt(seed))),
    "caption.npy": textFile(caption),
    "skeleton.npy": textFile(skeleton),
  });
}

// Offers downloads; without `template`, the bytes of a GLB file with the figure, only archives.
export function offerDownloads(session, model, template) {
  const writers = { NPZ: (motion) => archiveOf(motion, model) };
  if (template) {
    writers.GLB = ({ positions, caption }) => {
      const { parents, fps, joints } = model;
      return animatedFigure(template, framesOf(positions, joints.length), { parents, fps, caption });
    };
  }
  const buttons = Object.entries(writers).reverse().map(([format, write]) => create("button", {
    type: "button", className: "quiet", textContent: format, disabled: true,
    onclick: () => saveBlob(write(session.motion), fileName(session.motion, null, format.toLowerCase())),
  }));
  for (const button of buttons) button.setAttribute("aria-label", `Download ${button.textContent}`);
  find("downloads").replaceChildren(...buttons);
  session.onChange(["take"], () => buttons.forEach((button) => { button.disabled = session.motion === null; }));
}
