/** Rows of the panel, by kind of control. */

import { LogarithmicRange, Note, NumberField, VectorFields } from "./widgets.js";

/** Colours: [r, g, b] sRGB 0..1 in messages, "#rrggbb" in lil-gui. */
const toByte = (value) => Math.round(255 * Math.min(1, Math.max(0, value)));
const toHex = (channels) => "#" + channels.map((value) => toByte(value).toString(16).padStart(2, "0")).join("");
const fromHex = (hex) => [1, 3, 5].map((start) => parseInt(hex.slice(start, start + 2), 16) / 255);

const toNumber = (value) => (Number.isFinite(value) ? value : 0);
const same = (a, b) => JSON.stringify(a) === JSON.stringify(b); // option values may be lists or null
const itself = (value) => value;

/**
 * For each kind: conversion from a message's value to lil-gui's model (`inward`), back (`outward`), and the row.
 * The model is {value}; `add` makes the row in a lil-gui folder.
 */
const KINDS = {
  choice: ({ options }) => {
    const labels = options.map(([, label]) => String(label));
    return {
      inward: (value) => labels[options.findIndex(([option]) => same(option, value))] ?? String(value),
      outward: (label) => options[labels.indexOf(label)][0],
      // Release focus, so that keys move the camera.
      add: (folder, model) => folder.add(model, "value", labels).onFinishChange(() => document.activeElement?.blur()),
    };
  },
  range: ({ min, max, step, log }) => ({
    inward: toNumber,
    add: (folder, model) =>
      log && min > 0
        ? new LogarithmicRange(folder, model, { min, max, step })
        : new NumberField(folder, model, { min, max, step }),
  }),
  number: ({ step }) => ({ inward: toNumber, add: (folder, model) => new NumberField(folder, model, { step }) }),
  switch: () => ({ inward: Boolean, add: (folder, model) => folder.add(model, "value") }),
  color: () => ({ inward: toHex, outward: fromHex, add: (folder, model) => folder.addColor(model, "value") }),
  vector: () => ({ inward: (value) => value.map(toNumber), add: (folder, model) => new VectorFields(folder, model) }),
  note: () => ({ inward: (value) => String(value ?? ""), add: (folder, model) => new Note(folder, model) }),
};

/** Add a button. */
function addButton(folder, pressed) {
  return folder.add({ press: pressed }, "press");
}

/** Add a row with a value; `show` sets it without calling `changed`. */
function addValue(folder, control, changed) {
  const { inward, outward = itself, add } = KINDS[control.kind](control);
  const model = { value: inward(control.value) };
  const row = add(folder, model);
  row.onChange(() => changed(outward(model.value)));
  const show = (value) => {
    model.value = inward(value);
    row.updateDisplay();
  };
  return { row, show };
}

/**
 * Add a control to a folder; return null if its kind is unknown or its description invalid.
 * @param {{changed: (value: any) => void, pressed: () => void}} on
 * @returns {{show: (value: any) => void} | null}
 */
export function addControl(folder, control, on) {
  try {
    const button = control.kind === "button";
    const { row, show } = button
      ? { row: addButton(folder, on.pressed), show: () => {} }
      : addValue(folder, control, on.changed);
    row.name(String(control.label ?? control.name));
    row.domElement.dataset.name = control.name;
    row.domElement.title = control.hint ?? "";
    return { show };
  } catch (error) {
    console.warn("pointray: ignored an invalid control:", control, error);
    return null;
  }
}
