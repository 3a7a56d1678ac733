// JAX's random numbers (Threefry-2x32 with 20 rounds, Salmon et al. 2011), so that a seed gives the motion that it gives in
// Python. A key is two whole numbers of 32 bits.

const ROTATIONS = [[13, 15, 26, 6], [17, 29, 16, 24]];
const PARITY = 0x1bd11bda;
const STOP_STREAM = 2 ** 31; // as in t2m_jax/sampling/loop.py
const TINY = 2 ** -126; // the smallest normal number of 32 bits, in place of 0

const rotate = (value, bits) => (value << bits) | (value >>> (32 - bits));

// Returns two numbers for a key and a counter of two numbers.
export function threefry([key0, key1], [count0, count1]) {
  const keys = [key0, key1, key0 ^ key1 ^ PARITY];
  let [a, b] = [(count0 + key0) | 0, (count1 + key1) | 0];
  for (let group = 0; group < 5; group += 1) {
    for (const bits of ROTATIONS[group % 2]) {
      a = (a + b) | 0;
      b = rotate(b, bits) ^ a;
    }
    a = (a + keys[(group + 1) % 3]) | 0;
    b = (b + keys[(group + 2) % 3] + group + 1) | 0;
  }
  return [a >>> 0, b >>> 0];
}

export const newKey = (seed) => [0, seed >>> 0];

// `jax.random.fold_in`
export const foldIn = (key, number) => threefry(key, [0, number >>> 0]);

// `jax.random.split`
export const split = (key, count) => Array.from({ length: count }, (_, index) => threefry(key, [0, index]));

// Returns numbers from 0 up to 1 without 1, in steps of 2 ** -23, as `jax.random.uniform` does.
export function uniform(key, count) {
  return Float32Array.from({ length: count }, (_, index) => {
    const [a, b] = threefry(key, [0, index]);
    return ((a ^ b) >>> 9) * 2 ** -23 || TINY;
  });
}

const log = (value) => Math.fround(Math.log(value));

export const gumbel = (key, count) => uniform(key, count).map((value) => -log(-log(value)));

export function logistic(key) {
  const [value] = uniform(key, 1);
  return Math.fround(log(value) - Math.fround(Math.log1p(-value)));
}

const CRC_TABLE = Uint32Array.from({ length: 256 }, (_, byte) => {
  let value = byte;
  for (let bit = 0; bit < 8; bit += 1) value = value & 1 ? (value >>> 1) ^ 0xedb88320 : value >>> 1;
  return value;
});

export function crc32(bytes) {
  let value = 0xffffffff;
  for (const byte of bytes) value = (value >>> 8) ^ CRC_TABLE[(value ^ byte) & 255];
  return (value ^ 0xffffffff) >>> 0;
}

// Returns the key of one sample of a sentence.
export function sampleKey(seed, sentence, sample) {
  return foldIn(foldIn(newKey(seed), crc32(new TextEncoder().encode(sentence))), sample);
}

// Returns the noise of a row: for each class of each code, and for the end of the motion.
export function rowNoise(key, row, { depth, classes }) {
  const rowKey = foldIn(key, row);
  const keys = depth > 1 ? split(rowKey, depth) : [rowKey];
  const codes = new Float32Array(depth * classes);
  keys.forEach((one, place) => codes.set(gumbel(one, classes), place * classes));
  return { codes, end: logistic(foldIn(foldIn(key, STOP_STREAM), row)) };
}
