// Files for download.

import { create } from "./dom.js";

export function fileName(motion, number, format) {
  const words = motion.caption.toLowerCase().replace(/[^\p{L}\p{N}]+/gu, "-").replace(/^-|-$/g, "");
  return [[...words].slice(0, 40).join("") || "motion", motion.seed, number].filter((part) => part !== null && part !== undefined).join("-") + `.${format}`;
}

export function saveBlob(blob, download) {
  const href = URL.createObjectURL(blob);
  create("a", { href, download }).click();
  setTimeout(() => URL.revokeObjectURL(href), 60_000); // the browser may still be reading it
}
