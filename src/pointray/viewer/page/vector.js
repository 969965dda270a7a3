/** Vectors of three float64: world coordinates may be in the millions, with details of millimetres. */

/** @typedef {[number, number, number]} Vector */

export const add = (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]];

export const subtract = (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]];

export const scale = (a, factor) => [a[0] * factor, a[1] * factor, a[2] * factor];

export const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];

export const cross = (a, b) => [
  a[1] * b[2] - a[2] * b[1],
  a[2] * b[0] - a[0] * b[2],
  a[0] * b[1] - a[1] * b[0],
];

export const length = (a) => Math.hypot(a[0], a[1], a[2]);

/** Normalize a vector; the zero vector stays zero. */
export const unit = (a) => scale(a, 1 / (length(a) || 1));

/** Interpolate linearly from a to b; share 0..1. Exactly b at 1. */
export const mix = (a, b, share) => a.map((value, axis) => value * (1 - share) + b[axis] * share);

/** Return whether a value of a message is a finite vector. */
export const isVector = (value) => Array.isArray(value) && value.length === 3 && value.every(Number.isFinite);
