// How sentences follow each other in one motion, as t2m_jax/motion/joining.py and cleanup.py do it. `rows` are lists of
// frames, and a frame is a list of numbers.

const FADE_SECONDS = 0.4; // in which features of a sentence fade into those of the next
const SEAM_SECONDS = 0.5; // on each side of a seam, in which motion is smoothed
const SEAM_SIGMA = 0.1; // of the filter there, in seconds
const TRUNCATE = 4; // standard deviations to which a Gaussian reaches
const OVERLAP_SECONDS = 2; // that two windows of the clean-up share

const clamp = (value, low, high) => Math.min(Math.max(value, low), high);
const mix = (one, other, share) => one.map((value, place) => (1 - share) * value + share * other[place]);

// The share of what follows: level at 0 and at 1.
function fade(time) {
  const inside = clamp(time, 0, 1);
  return inside ** 2 * (3 - 2 * inside);
}

// Python's `round`: halves go to the even number.
function round(value) {
  const below = Math.floor(value);
  if (value - below !== 0.5) return Math.round(value);
  return below % 2 ? below + 1 : below;
}

// Returns two lists of features, in which the end of the first one fades into the begin of the second one.
export function fadeFeatures(first, second, fps) {
  const half = Math.min(round(FADE_SECONDS * fps), first.length, second.length) >> 1;
  const shareAt = (place) => fade((place + 1) / (2 * half + 1));
  const ending = first.slice(first.length - half).map((row, place) => mix(row, second[0], shareAt(place)));
  const beginning = second.slice(0, half).map((row, place) => mix(first.at(-1), row, shareAt(half + place)));
  return [[...first.slice(0, first.length - half), ...ending], [...beginning, ...second.slice(half)]];
}

// Returns positions that are smoothed near the frames in which sentences begin.
export function easeSeams(rows, seams, fps) {
  const sigma = SEAM_SIGMA * fps;
  const radius = Math.floor(TRUNCATE * sigma + 0.5);
  const kernel = Array.from({ length: 2 * radius + 1 }, (_, place) => Math.exp(-0.5 * ((place - radius) / sigma) ** 2));
  const total = kernel.reduce((sum, weight) => sum + weight, 0);
  const reach = Math.ceil(SEAM_SECONDS * fps);
  const result = rows.slice();
  for (const seam of seams) {
    const [first, last] = [Math.max(0, seam - reach), Math.min(rows.length, seam + reach)];
    const [low, high] = [Math.max(0, first - radius), Math.min(rows.length, last + radius) - 1];
    for (let frame = first; frame < last; frame += 1) {
      const smooth = rows[frame].map((_, place) => kernel.reduce((sum, weight, step) => sum + weight * rows[clamp(frame + step - radius, low, high)][place], 0) / total);
      const distance = Math.min(...seams.map((one) => Math.abs(frame - one + 0.5))); // a seam is between two frames
      result[frame] = mix(rows[frame], smooth, fade(1 - distance / (SEAM_SECONDS * fps)));
    }
  }
  return result;
}

// Resolves to a long motion that `calm` changes window by window; each window fades into the next one.
export async function inWindows(rows, size, fps, calm) {
  const overlap = Math.min(round(OVERLAP_SECONDS * fps), size >> 1);
  let result = [];
  for (let first = 0; first === 0 || first < rows.length - overlap; first += size - overlap) {
    const window = await calm(rows.slice(first, first + size));
    const mixed = window.map((row, place) => (first + place < result.length ? mix(result[first + place], row, fade((2 * place) / overlap - 0.5)) : row));
    result = [...result.slice(0, first), ...mixed];
  }
  return result;
}
