// Vectors as lists of numbers.

export const add = (a, b, scale = 1) => a.map((value, axis) => value + scale * b[axis]);
export const subtract = (a, b) => add(a, b, -1);
export const scaled = (a, factor) => a.map((value) => value * factor);
export const dot = (a, b) => a.reduce((sum, value, axis) => sum + value * b[axis], 0);
export const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];
export const length = (a) => Math.sqrt(dot(a, a));
export const unit = (a) => scaled(a, 1 / Math.max(length(a), 1e-12)); // zero stays zero
export const sum = (values) => values.reduce((total, value) => total + value, 0);
