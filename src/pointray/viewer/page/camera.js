/**
 * The camera and its movements: pure functions from a camera to a camera.
 *
 * Movements of the pointer are fractions of the window's height, angles radians, all else world units.
 */

import { add, cross, dot, isVector, length, mix, scale, subtract, unit } from "./vector.js";

/**
 * @typedef {{eye: number[], target: number[], up: number[], fov: number, orthographic?: boolean}} Camera
 *   fov: vertical, degrees; an orthographic one shows as much as this angle does at the target's distance
 */

const STEEPEST = ((90 - 0.5) * Math.PI) / 180; // elevation at which an orbit stops, short of the pole
const PARALLEL = 1e-6; // sine of the angle between view and up below which up says nothing

const NARROWEST = 0.02; // degrees, and
const WIDEST = 170; // of an orthographic camera's angle

const radians = (degrees) => (degrees * Math.PI) / 180;
const angleOf = (half) => Math.max(NARROWEST, Math.min(WIDEST, (2 * Math.atan(half) * 180) / Math.PI));

/** Whether a message's value is a camera that sees something. */
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

/** A camera of its own, without what else a message carries. */
export const copyCamera = ({ eye, target, up, fov, orthographic = false }) => ({
  eye: [...eye],
  target: [...target],
  up: [...up],
  fov,
  orthographic,
});

/** Whether two cameras take the same picture. */
export function sameCamera(a, b) {
  const same = (name) => a[name].every((value, axis) => value === b[name][axis]);
  return a.fov === b.fov && a.orthographic === b.orthographic && same("eye") && same("target") && same("up");
}

/** The unit vectors of the view; where up is parallel to it, the axes that the renderer takes (camera.py, _axes). */
export function viewAxes(camera) {
  const forward = unit(subtract(camera.target, camera.eye));
  const choices = [unit(camera.up), [0, 1, 0], [1, 0, 0]];
  const across = choices.map((up) => cross(forward, up)).find((vector) => length(vector) > PARALLEL);
  const right = unit(across);
  return { forward, right, top: cross(right, forward) };
}

/** How far the eye is from its target. */
export const targetDistance = (camera) => length(subtract(camera.eye, camera.target));

/** World units at the target's distance that the window's height shows. */
export const heightAtTarget = (camera) => 2 * targetDistance(camera) * Math.tan(radians(camera.fov) / 2);

/** The eye as seen from the target: distance, elevation above the plane across `pole`, unit direction in that plane. */
function turntable(camera, pole) {
  const offset = subtract(camera.eye, camera.target);
  const rise = dot(offset, pole);
  const level = subtract(offset, scale(pole, rise));
  const distance = length(offset);
  const elevation = Math.atan2(rise, length(level));
  if (length(level) > PARALLEL * distance) return { distance, elevation, heading: unit(level) };
  // Over the pole the eye would leave it towards the picture's lower edge; under it, towards the upper one.
  const { top } = viewAxes(camera);
  const back = subtract(top, scale(pole, dot(top, pole)));
  return { distance, elevation, heading: unit(scale(back, -Math.sign(rise) || 1)) };
}

/** Where the eye is, from the target: the inverse of `turntable`. */
function offsetOf({ distance, elevation, heading }, pole) {
  const level = scale(heading, distance * Math.cos(elevation));
  return add(level, scale(pole, distance * Math.sin(elevation)));
}

/** A vector across the pole, turned about it. */
const turned = (heading, pole, angle) =>
  add(scale(heading, Math.cos(angle)), scale(cross(pole, heading), Math.sin(angle)));

/** The eye moves about the target: `right` about the up axis, `rise` towards its pole. */
export function orbit(camera, right, rise) {
  const pole = unit(camera.up);
  const from = turntable(camera, pole);
  const elevation = Math.max(-STEEPEST, Math.min(STEEPEST, from.elevation + rise));
  const heading = turned(from.heading, pole, right);
  return { ...camera, eye: add(camera.target, offsetOf({ ...from, elevation, heading }, pole)) };
}

/** Eye and target move together. */
export function shift(camera, by) {
  return { ...camera, eye: add(camera.eye, by), target: add(camera.target, by) };
}

/** The other projection: at the target's distance it shows the same. fov: of a perspective one, degrees. */
export function reproject(camera, fov) {
  if (!camera.orthographic) return { ...camera, orthographic: true };
  const distance = heightAtTarget(camera) / (2 * Math.tan(radians(fov) / 2));
  const eye = add(camera.target, scale(viewAxes(camera).forward, -distance));
  return { ...camera, eye, fov, orthographic: false };
}

/** The plane through the target follows the pointer, which moved by dx, dy (down is positive). */
export function pan(camera, dx, dy) {
  const { right, top } = viewAxes(camera);
  const height = heightAtTarget(camera);
  return shift(camera, add(scale(right, -dx * height), scale(top, dy * height)));
}

/** The eye's distance to its target times a factor, no less than `least`. */
export function dolly(camera, factor, least = 0) {
  if (camera.orthographic) {
    // The eye stays where it is: closer, it would pass what is before the target.
    return { ...camera, fov: angleOf(Math.tan(radians(camera.fov) / 2) * factor) };
  }
  const distance = targetDistance(camera);
  const wanted = Math.max(distance * factor, Math.min(distance, least));
  if (!Number.isFinite(wanted) || wanted <= 0) return camera;
  return { ...camera, eye: add(camera.target, scale(subtract(camera.eye, camera.target), wanted / distance)) };
}

/** Eye and target move by lengths [right, up, forward]; up is the up axis, as walking on the ground would have it. */
export function fly(camera, [right, up, forward]) {
  const axes = viewAxes(camera);
  const level = add(scale(axes.right, right), scale(axes.forward, forward));
  return shift(camera, add(level, scale(unit(camera.up), up)));
}

/** The same view of another target. */
export const aimedAt = (camera, target) => ({ ...shift(camera, subtract(target, camera.target)), target });

/**
 * The camera at a share 0..1 of the way from a to b.
 *
 * The eye moves about the target on an arc, as an orbit would: azimuth the shorter way round, elevation, and the
 * logarithm of the distance evenly. An arc of a great circle could pass over the pole, where the picture flips.
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

/** A function from a point to its place in the picture: x, y 0..1 from the left and the top; depth along the view. */
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
