// NumPy archives (.npz): a ZIP file without compression, with an array in each entry. All numbers are little-endian.

import { crc32 } from "./random.js";

const LOCAL = 0x04034b50; // signatures of ZIP
const CENTRAL = 0x02014b50;
const END = 0x06054b50;
const VERSION = 20;
const MIDNIGHT = 0x21; // of 1 January 1980, so that equal motions are equal files
const encode = (text) => new TextEncoder().encode(text);

// Returns little-endian numbers as bytes, from pairs of a size in bytes and a value.
function pack(...fields) {
  const view = new DataView(new ArrayBuffer(fields.reduce((sum, [size]) => sum + size, 0)));
  let place = 0;
  for (const [size, value] of fields) {
    if (size === 2) view.setUint16(place, value, true);
    else view.setUint32(place, value, true);
    place += size;
  }
  return new Uint8Array(view.buffer);
}

// Returns the content of a .npy file; `values` is a typed array.
export function arrayFile(type, shape, values) {
  const dictionary = `{'descr': '${type}', 'fortran_order': False, 'shape': (${shape.map((size) => `${size},`).join(" ")}), }`;
  const header = `${dictionary.padEnd(Math.ceil((dictionary.length + 11) / 64) * 64 - 11)}\n`;
  const start = [0x93, ...encode("NUMPY"), 1, 0, ...pack([2, header.length])];
  return new Uint8Array([...start, ...encode(header), ...new Uint8Array(values.buffer, values.byteOffset, values.byteLength)]);
}

export function textsFile(texts, shape = [texts.length]) {
  const width = Math.max(...texts.map((text) => [...text].length), 1);
  const letters = new Uint32Array(texts.length * width);
  texts.forEach((text, place) => letters.set([...text].map((letter) => letter.codePointAt(0)), place * width));
  return arrayFile(`<U${width}`, shape, letters);
}

export const textFile = (text) => textsFile([text], []);

// Returns a blob with the contents, by name.
export function zipFile(contents) {
  const parts = [];
  const entries = [];
  let offset = 0;
  for (const [name, data] of Object.entries(contents)) {
    const size = [[4, crc32(data)], [4, data.length], [4, data.length]];
    const about = [[2, VERSION], [2, 0], [2, 0], [2, 0], [2, MIDNIGHT], ...size, [2, encode(name).length], [2, 0]];
    const local = [pack([4, LOCAL], ...about), encode(name), data];
    entries.push(pack([4, CENTRAL], [2, VERSION], ...about, [2, 0], [2, 0], [2, 0], [4, 0], [4, offset]), encode(name));
    parts.push(...local);
    offset += local.reduce((sum, { length }) => sum + length, 0);
  }
  const size = entries.reduce((sum, { length }) => sum + length, 0);
  const count = entries.length / 2;
  return new Blob([...parts, ...entries, pack([4, END], [2, 0], [2, 0], [2, count], [2, count], [4, size], [4, offset], [2, 0])]);
}
