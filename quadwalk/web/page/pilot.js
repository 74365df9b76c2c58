/** The velocity command: from held keys, sticks or a script, on its way to what they ask. */

import { clip } from "./controller.js";

const WALK = 1; // m/s, of W without shift
const GALLOP = 4; // m/s, of W with shift
const TURN = 1.5; // rad/s, of A and D
const ASIDE = 0.4; // m/s, of Q and E
const ACCELERATION = 4; // m/s^2, where the policy states none
const TURNING = 8; // rad/s^2
const SWERVING = 2; // m/s^2, of the lateral velocity

/** What the robot does by itself: seconds, and a command (3,). */
export const TOUR = [
  [1.5, [0, 0, 0]],
  [3, [1, 0, 0]],
  [4, [4, 0, 0]],
  [3, [2, 0, 1.2]],
  [3, [1, 0, -1.2]],
  [2, [0, 0, 1.5]],
  [2, [0.3, 0.4, 0]],
  [2, [-0.6, 0, 0]],
];

/** Makes the velocity command of each control step. */
export class Pilot {
  /** @param {Record<string, string>} metadata of the policy */
  constructor(metadata) {
    /** @type {number[][]} (3, 2) of forward and lateral velocity, m/s, and yaw rate, rad/s */
    this.ranges = Object.values(JSON.parse(metadata.command_ranges ?? "{}"));
    this.limits = JSON.parse(metadata.command_limits ?? "{}");
    this.acceleration = this.limits.acceleration ?? ACCELERATION;
    /** Return true if the policy obeys commands at all. */
    this.isSteered = this.ranges.length === 3;
    this.command = [0, 0, 0];
    /** @type {Set<string>} what keys and buttons hold down */
    this.held = new Set();
    /** @type {[number, number, number]} what sticks ask, as shares of the ranges, -1 to 1 */
    this.sticks = [0, 0, 0];
    /** @type {"stand" | "walk"} what it does when all is released */
    this.release = "stand";
    /** @type {{parts: any[], index: number, time: number, repeats: boolean} | null} */
    this.script = { parts: TOUR, index: 0, time: 0, repeats: true };
    this.isStopped = false;
  }

  /**
   * Follow a script of commands.
   * @param {any[]} parts seconds and command (3,) of each part
   * @param {boolean} repeats
   */
  follow(parts, repeats = false) {
    this.script = { parts, index: 0, time: 0, repeats };
  }

  /**
   * Hold or release something; the first hold ends the script.
   * @param {string} name as input.js names it
   * @param {boolean} isDown
   */
  hold(name, isDown) {
    if (!isDown) {
      this.held.delete(name);
      return;
    }
    this.takeOver();
    this.held.add(name);
  }

  /**
   * Set what sticks ask; the first push ends the script.
   * @param {number} forward share of the range, -1 to 1
   * @param {number} left
   * @param {number} turn
   */
  steer(forward, left, turn) {
    if (forward || left || turn) this.takeOver();
    this.sticks = [forward, left, turn];
  }

  /** End the script and a stop. */
  takeOver() {
    this.script = null;
    this.isStopped = false;
  }

  /** Release all, as when the page loses the focus. */
  releaseAll() {
    this.held.clear();
    this.sticks = [0, 0, 0];
  }

  /** Come to a stand, and stay so until something is held. */
  stop() {
    this.releaseAll();
    this.script = null;
    this.isStopped = true;
  }

  /** Return the command (3,) that is asked for now, within the policy's ranges. */
  get wanted() {
    if (!this.isSteered) return [0, 0, 0];
    if (this.script) return this.bound(this.script.parts[this.script.index][1]);
    if (this.isStopped) return [0, 0, 0];
    const { held, sticks, ranges } = this;
    const pair = (/** @type {string} */ plus, /** @type {string} */ minus) =>
      Number(held.has(plus)) - Number(held.has(minus));
    const direction = pair("ahead", "back");
    const fast = held.has("gallop") ? GALLOP : WALK;
    const isIdle = held.size === Number(held.has("gallop")) && sticks.every((x) => x === 0);
    const forward = isIdle && this.release === "walk" ? WALK : direction * fast;
    const asked = [forward, pair("left", "right") * ASIDE, pair("turnLeft", "turnRight") * TURN];
    return this.bound(
      asked.map((value, k) => {
        const [low, high] = ranges[k];
        return value + sticks[k] * (sticks[k] > 0 ? high : -low);
      }),
    );
  }

  /**
   * Bound a command (3,) by what the policy was trained with.
   * @param {number[]} command
   */
  bound(command) {
    const [forward, lateral, turn] = command.map((x, k) =>
      clip(x, this.ranges[k][0], this.ranges[k][1]),
    );
    const speed = Math.abs(this.command[0]);
    const { lateral_until: until, turning } = this.limits;
    const aside = until ? Math.max(1 - speed / until, 0) : 1;
    const most = turning ? turning / Math.max(speed, 1e-6) : Infinity;
    return [forward, lateral * aside, clip(turn, -most, most)];
  }

  /**
   * Move the command on its way for a control step.
   * @param {number} dt s
   */
  update(dt) {
    this.advance(dt);
    const wanted = this.wanted;
    const rates = [this.acceleration, SWERVING, TURNING];
    this.command = this.command.map((x, k) => {
      const change = clip(wanted[k] - x, -rates[k] * dt, rates[k] * dt);
      const next = x + change;
      return Math.abs(next) < 1e-9 ? 0 : next;
    });
    return this.command;
  }

  /**
   * Move the script on.
   * @param {number} dt s
   */
  advance(dt) {
    const { script } = this;
    if (!script) return;
    script.time += dt;
    if (script.time < script.parts[script.index][0]) return;
    script.time = 0;
    script.index += 1;
    if (script.index < script.parts.length) return;
    script.index = 0;
    if (!script.repeats) this.stop();
  }
}
