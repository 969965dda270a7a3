/** Current camera: moved immediately by drags, over time by animations and held keys. */

import * as moves from "./camera.js";
import { isVector, length, scale, subtract } from "./vector.js";

const GLIDE = 300; // ms, duration of an animation
const FOV = 40; // degrees, default of perspective views
const FLIGHT = 1 / 4; // speed in diagonals of the model per second
const HURRY = 4; // speed factor with Shift
const TURN = Math.PI / 3; // radians per second, arrow keys
const CLOSEST = 1e-5; // minimum distance to the target in diagonals
const LONGEST_STEP = 100; // ms; limits the flight after the browser was suspended
const NORMAL_STEP = 1000 / 60; // ms, first step of a key, so that a tap moves the camera

/** Ease in and out; share 0..1. */
const ease = (share) => share * share * (3 - 2 * share);

export class Motion {
  /** @type {moves.Camera | null} null before the server has sent one */
  camera = null;
  diagonal = 1;
  #glide = null;
  #keys = { flight: [0, 0, 0], turn: [0, 0], fast: false };
  #before = 0;
  #fov = FOV; // fov of the last perspective view

  /** Set the model's bounds, which scale speeds and distances. */
  setBounds(bounds) {
    if (!Array.isArray(bounds) || !bounds.every(isVector) || bounds.length !== 2) return;
    this.diagonal = length(subtract(bounds[1], bounds[0])) || 1;
  }

  /** Apply a movement by the user and stop any animation. */
  move(movement) {
    if (!this.camera) return;
    this.#glide = null;
    this.camera = movement(this.camera);
  }

  orbit(right, rise) {
    this.move((camera) => moves.orbit(camera, right, rise));
  }

  pan(dx, dy) {
    this.move((camera) => moves.pan(camera, dx, dy));
  }

  dolly(factor) {
    this.move((camera) => moves.dolly(camera, factor, CLOSEST * this.diagonal));
  }

  /** Set the camera immediately. */
  jump(camera) {
    this.#glide = null;
    this.camera = moves.copyCamera(camera);
  }

  /** Start an animation to a camera; `advance` does the steps. */
  glide(camera) {
    if (!this.camera) return this.jump(camera);
    this.#glide = { from: this.camera, to: camera, began: null };
  }

  /** Switch between perspective and orthographic projection. */
  reproject() {
    if (this.camera && !this.camera.orthographic) this.#fov = this.camera.fov;
    this.move((camera) => moves.reproject(camera, this.#fov));
  }

  /** Animate the target to a point, keeping distance and direction of the view. */
  aim(position) {
    if (this.camera && isVector(position)) this.glide(moves.aimedAt(this.camera, position));
  }

  /** Set the directions of held keys: flight [right, up, forward], turn [right, up]; each -1, 0 or 1. */
  hold(keys) {
    const resting = !this.#held;
    this.#keys = keys;
    if (!resting || !this.#held || !this.camera) return;
    this.#before = 0;
    this.#step(performance.now());
  }

  get #held() {
    return [...this.#keys.flight, ...this.#keys.turn].some((way) => way !== 0);
  }

  /** Advance to time `now` in ms; return whether motion continues. */
  advance(now) {
    if (!this.camera) return false;
    if (this.#held) this.#step(now);
    if (this.#glide) this.#slide(now);
    return this.#held || this.#glide !== null;
  }

  #step(now) {
    const passed = this.#before ? Math.min(Math.max(now - this.#before, 0), LONGEST_STEP) : NORMAL_STEP;
    this.#before = Math.max(now, this.#before);
    const { flight, turn, fast } = this.#keys;
    const seconds = (passed / 1000) * (fast ? HURRY : 1);
    const way = scale(flight, seconds * FLIGHT * this.diagonal);
    if (flight.some(Boolean)) this.move((camera) => moves.fly(camera, way));
    if (turn.some(Boolean)) this.orbit(turn[0] * TURN * seconds, turn[1] * TURN * seconds);
  }

  #slide(now) {
    const { from, to } = this.#glide;
    this.#glide.began ??= now;
    const share = Math.min(1, (now - this.#glide.began) / GLIDE);
    this.camera = moves.between(from, to, ease(share));
    if (share === 1) this.#glide = null;
  }
}
