/** Where the camera is now: moved at once by a drag, over time by an animation or keys that are held. */

import * as moves from "./camera.js";
import { isVector, length, scale, subtract } from "./vector.js";

const GLIDE = 300; // ms an animation takes
const FOV = 40; // degrees, of a perspective view that was orthographic from the start
const FLIGHT = 1 / 4; // diagonals of the model a second
const HURRY = 4; // times as fast, with Shift
const TURN = Math.PI / 3; // radians a second, arrow keys
const CLOSEST = 1e-5; // least distance to the target, diagonals
const LONGEST_STEP = 100; // ms; a browser that slept must not fly through the wall
const NORMAL_STEP = 1000 / 60; // ms, for the first step of a key: a tap moves, too

/** Slow at both ends; share 0..1. */
const ease = (share) => share * share * (3 - 2 * share);

export class Motion {
  /** @type {moves.Camera | null} none before the server's first one */
  camera = null;
  diagonal = 1;
  #glide = null;
  #keys = { flight: [0, 0, 0], turn: [0, 0], fast: false };
  #before = 0;
  #fov = FOV; // of the last perspective view

  /** The model's box, for speeds and distances. */
  setBounds(bounds) {
    if (!Array.isArray(bounds) || !bounds.every(isVector) || bounds.length !== 2) return;
    this.diagonal = length(subtract(bounds[1], bounds[0])) || 1;
  }

  /** A movement by hand, which ends an animation. */
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

  /** Is there at once; also the first camera of all. */
  jump(camera) {
    this.#glide = null;
    this.camera = moves.copyCamera(camera);
  }

  /** Goes there smoothly; `advance` does the steps. */
  glide(camera) {
    if (!this.camera) return this.jump(camera);
    this.#glide = { from: this.camera, to: camera, began: null };
  }

  /** Perspective becomes orthographic, and back. */
  reproject() {
    if (this.camera && !this.camera.orthographic) this.#fov = this.camera.fov;
    this.move((camera) => moves.reproject(camera, this.#fov));
  }

  /** The orbit's target glides to a point; distance and direction of the view stay. */
  aim(position) {
    if (this.camera && isVector(position)) this.glide(moves.aimedAt(this.camera, position));
  }

  /** Which way held keys take the camera from now on: flight [right, up, forward], turn [right, up]; each -1, 0, 1. */
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

  /** One step, `now` in ms; whether more are to come. */
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
