/**
 * Camera movements: pure functions from a camera to a camera.
 *
 * Pointer movements are fractions of the window's height, angles are in radians, all else is in world units.
 */

import { add, cross, dot, isVector, length, mix, scale, subtract, unit } from "./vector.js";

/**
 * @typedef {{eye: number[], target: number[], up: number[], fov: number, orthographic?: boolean}} Camera
 *   fov: vertical, degrees; an orthographic camera shows what this angle covers at the target's distance
 */

const STEEPEST = ((90 - 0.5) * Math.PI) / 180; // limit of the elevation, just below the pole
const PARALLEL = 1e-6; // sine of the angle between view and up, below which they count as parallel

const NARROWEST = 0.02; // degrees, limits of
const WIDEST = 170; // an orthographic camera's angle

const radians = (degrees) => (degrees * Math.PI) / 180;
const angleOf = (half) => Math.max(NARROWEST, Math.min(WIDEST, (2 * Math.atan(half) * 180) / Math.PI));

/** Return whether a value of a message is a valid camera. */
export function isCamera(value) {
  return (
    isVector(value?.eye) &&
    isVector(value.target) &&
    isVector(value.up) &&
    length(value.up) > 0 &&
    length(subtract(value.eye, value.target)) > 0 &&
    value.fov > 0 &&
    value.fov < 180
  );
}

/** Copy a camera without the other fields of a message. */
export const copyCamera = ({ eye, target, up, fov, orthographic = false }) => ({
  eye: [...eye],
  target: [...target],
  up: [...up],
  fov,
  orthographic,
});

/** Return whether two cameras give the same image. */
export function sameCamera(a, b) {
  const same = (name) => a[name].every((value, axis) => value === b[name][axis]);
  return a.fov === b.fov && a.orthographic === b.orthographic && same("eye") && same("target") && same("up");
}

/** Return the unit vectors of the view. If up is parallel to it, use the renderer's axes (view_axes in camera.py). */
export function viewAxes(camera) {
  const forward = unit(subtract(camera.target, camera.eye));
  const choices = [unit(camera.up), [0, 1, 0], [1, 0, 0]];
  const across = choices.map((up) => cross(forward, up)).find((vector) => length(vector) > PARALLEL);
  const right = unit(across);
  return { forward, right, top: cross(right, forward) };
}

/** Distance from the eye to the target. */
export const targetDistance = (camera) => length(subtract(camera.eye, camera.target));

/** Height of the window in world units at the target's distance. */
export const heightAtTarget = (camera) => 2 * targetDistance(camera) * Math.tan(radians(camera.fov) / 2);

/** Position of the eye relative to the target: distance, elevation, and unit heading in the plane normal to `pole`. */
function turntable(camera, pole) {
  const offset = subtract(camera.eye, camera.target);
  const rise = dot(offset, pole);
  const level = subtract(offset, scale(pole, rise));
  const distance = length(offset);
  const elevation = Math.atan2(rise, length(level));
  if (length(level) > PARALLEL * distance) return { distance, elevation, heading: unit(level) };
  // At the upper pole the heading is the lower edge of the image, at the lower pole the upper edge.
  const { top } = viewAxes(camera);
  const back = subtract(top, scale(pole, dot(top, pole)));
  return { distance, elevation, heading: unit(scale(back, -Math.sign(rise) || 1)) };
}

/** Offset of the eye from the target: the inverse of `turntable`. */
function offsetOf({ distance, elevation, heading }, pole) {
  const level = scale(heading, distance * Math.cos(elevation));
  return add(level, scale(pole, distance * Math.sin(elevation)));
}

/** Rotate a vector normal to the pole about it. */
const turned = (heading, pole, angle) =>
  add(scale(heading, Math.cos(angle)), scale(cross(pole, heading), Math.sin(angle)));

/** Move the eye about the target: `right` about the up axis, `rise` towards its pole. */
export function orbit(camera, right, rise) {
  const pole = unit(camera.up);
  const from = turntable(camera, pole);
  const elevation = Math.max(-STEEPEST, Math.min(STEEPEST, from.elevation + rise));
  const heading = turned(from.heading, pole, right);
  return { ...camera, eye: add(camera.target, offsetOf({ ...from, elevation, heading }, pole)) };
}

/** Move eye and target together. */
export function shift(camera, by) {
  return { ...camera, eye: add(camera.eye, by), target: add(camera.target, by) };
}

/** Switch the projection, keeping the view at the target's distance. fov: degrees, for the perspective one. */
export function reproject(camera, fov) {
  if (!camera.orthographic) return { ...camera, orthographic: true };
  const distance = heightAtTarget(camera) / (2 * Math.tan(radians(fov) / 2));
  const eye = add(camera.target, scale(viewAxes(camera).forward, -distance));
  return { ...camera, eye, fov, orthographic: false };
}

/** Move the plane through the target with the pointer, by dx, dy (down is positive). */
export function pan(camera, dx, dy) {
  const { right, top } = viewAxes(camera);
  const height = heightAtTarget(camera);
  return shift(camera, add(scale(right, -dx * height), scale(top, dy * height)));
}

/** Multiply the distance to the target by a factor, to `least` at minimum. */
export function dolly(camera, factor, least = 0) {
  if (camera.orthographic) {
    // The eye stays: moving closer, it could pass objects in front of the target.
    return { ...camera, fov: angleOf(Math.tan(radians(camera.fov) / 2) * factor) };
  }
  const distance = targetDistance(camera);
  const wanted = Math.max(distance * factor, Math.min(distance, least));
  if (!Number.isFinite(wanted) || wanted <= 0) return camera;
  return { ...camera, eye: add(camera.target, scale(subtract(camera.eye, camera.target), wanted / distance)) };
}

/** Move eye and target by lengths [right, up, forward], where up is the up axis, not that of the image. */
export function fly(camera, [right, up, forward]) {
  const axes = viewAxes(camera);
  const level = add(scale(axes.right, right), scale(axes.forward, forward));
  return shift(camera, add(level, scale(unit(camera.up), up)));
}

/** Move the camera to another target, keeping the view direction. */
export const aimedAt = (camera, target) => ({ ...shift(camera, subtract(target, camera.target)), target });

/**
 * Interpolate from camera a to camera b; share 0..1.
 *
 * The eye moves about the target as in an orbit: azimuth (the shorter way), elevation and the logarithm of the
 * distance change evenly. A great circle could pass over the pole, where the image flips.
 */
export function between(a, b, share) {
  if (share >= 1) return copyCamera(b);
  const pole = unit(b.up);
  const from = turntable(a, pole);
  const to = turntable(b, pole);
  const angle = Math.atan2(dot(pole, cross(from.heading, to.heading)), dot(from.heading, to.heading));
  const place = {
    distance: from.distance * (to.distance / from.distance) ** share,
    elevation: from.elevation * (1 - share) + to.elevation * share,
    heading: turned(from.heading, pole, angle * share),
  };
  const target = mix(a.target, b.target, share);
  const up = mix(unit(a.up), pole, share);
  return {
    eye: add(target, offsetOf(place, pole)),
    target,
    up: length(up) > PARALLEL ? up : pole,
    fov: a.fov * (1 - share) + b.fov * share,
    orthographic: b.orthographic,
  };
}

/** Return a function that projects a point: x, y 0..1 from the left and the top; depth along the view. */
export function projector(camera, aspect) {
  const { forward, right, top } = viewAxes(camera);
  const half = Math.tan(radians(camera.fov) / 2);
  const distance = camera.orthographic ? targetDistance(camera) : 0;
  return (point) => {
    const offset = subtract(point, camera.eye);
    const depth = dot(offset, forward);
    const height = 2 * (distance || depth) * half;
    const x = 0.5 + dot(offset, right) / (height * aspect);
    const y = 0.5 - dot(offset, top) / height;
    return { x, y, depth };
  };
}
