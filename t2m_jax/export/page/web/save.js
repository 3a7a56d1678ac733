// Files of the selected motion.

import { create, find } from "../studio/dom.js";
import { fileName, saveBlob } from "../studio/savefile.js";
import { arrayFile, textFile, textsFile, zipFile } from "./archive.js";
import { bvhText } from "./bvh.js";
import { framesOf } from "./figure.js";
import { animatedFigure } from "./glb.js";
import { fitRig } from "./rig.js";

// Returns the motion as Python reads it: `t2m view motion.npz -o motion.gif` makes any other format of it.
function archiveOf({ positions, decoded, codes, caption, seed, frames, fps, part_starts: starts, part_captions: captions }, { joints, skeleton }) {
  const parts = { "part_starts.npy": arrayFile("<i4", [starts.length], Int32Array.from(starts)), "part_captions.npy": textsFile(captions) };
  return zipFile({
    ...(starts.length ? parts : {}),
    "positions.npy": arrayFile("<f4", [frames, joints.length, 3], positions),
    "positions_raw.npy": arrayFile("<f4", [frames, joints.length, 3], decoded),
    "codes.npy": arrayFile("<i4", [codes.length, codes[0].length], Int32Array.from(codes.flat())),
    "fps.npy": arrayFile("<f8", [], Float64Array.of(fps)),
    "seed.npy": arrayFile("<i8", [], BigInt64Array.of(BigInt(seed))),
    "caption.npy": textFile(caption),
    "skeleton.npy": textFile(skeleton),
  });
}

// Returns functions by format that make the content of a file. Without `template`, the bytes of a GLB file with the figure, there
// is only the archive: the other formats are made for one skeleton.
function writersOf(about, rig, template) {
  const archive = { NPZ: (motion) => archiveOf(motion, about) };
  if (!template || !rig) return archive;
  const framesFor = ({ positions }) => framesOf(positions, about.joints.length);
  return {
    GLB: (motion) => {
      const frames = framesFor(motion);
      return animatedFigure(template, frames, fitRig(frames, about, rig), about, motion);
    },
    BVH: (motion) => new Blob([bvhText(fitRig(framesFor(motion), about, rig), about, rig, motion)], { type: "text/plain" }),
    ...archive,
  };
}

// Offers downloads of the motion that is selected.
export function offerDownloads(session, { motion: about, figure, template }) {
  const writers = writersOf(about, figure.rig, template);
  const buttons = Object.entries(writers).map(([format, write]) => create("button", {
    type: "button", className: "quiet", textContent: format, disabled: true,
    onclick: () => saveBlob(write(session.motion), fileName(session.motion, null, format.toLowerCase())),
  }));
  for (const button of buttons) button.setAttribute("aria-label", `Download ${button.textContent}`);
  find("downloads").replaceChildren(...buttons);
  find("formats").hidden = Object.hasOwn(writers, "BVH");
  session.onChange(["take"], () => buttons.forEach((button) => { button.disabled = session.motion === null; }));
}
