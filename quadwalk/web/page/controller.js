/**
 * The policy of one episode and the joint controller that obeys it, as in the export's controller.py.
 *
 * States are MuJoCo's: q (19,) is the trunk's position, its quaternion wxyz and the joint angles,
 * v (18,) its velocity in world axes, its angular velocity in body axes and the joint velocities.
 */

/** @typedef {import("./onnx.js").Policy} Policy */
/** @typedef {import("./terrain.js").Terrain} Terrain */

export const FRICTION_SPEED = 0.1; // rad/s, over which joint friction passes through zero
const TAU = 2 * Math.PI;

/**
 * What an observation is computed from.
 * @typedef {object} State
 * @property {number[]} R (9,) rows of the rotation from the trunk's frame to the world's
 * @property {ArrayLike<number>} q (19,)
 * @property {ArrayLike<number>} v (18,)
 * @property {number[]} home (12,) rad
 * @property {ArrayLike<number>} last (12,) the last action
 * @property {ArrayLike<number>} command (3,)
 * @property {number} steps control steps since the start
 * @property {number} standing height of the trunk's origin in the home pose, m
 * @property {Terrain | null} terrain
 */

/** @param {State} state */
function headingOf({ R }) {
  return Math.atan2(R[3], R[0]);
}

/**
 * Turn a vector of the world (3,) into the trunk's frame.
 * @param {number[]} R
 * @param {ArrayLike<number>} x
 */
function toBody(R, x) {
  return [0, 1, 2].map((k) => R[k] * x[0] + R[3 + k] * x[1] + R[6 + k] * x[2]);
}

/** @param {number} x @param {number} low @param {number} high */
export function clip(x, low, high) {
  return Math.min(Math.max(x, low), high);
}

/**
 * Return points on a side of this length about its middle.
 * @param {number} side m
 * @param {number} spacing m
 */
function spread(side, spacing) {
  const gaps = Math.round(side / spacing);
  return Array.from({ length: gaps + 1 }, (_, k) => spacing * (k - gaps / 2));
}

/**
 * Return how far the ground lies below where it is in the home pose, at a grid about the trunk.
 * @param {State} state
 * @param {number[]} ahead m
 * @param {number[]} left m
 * @param {number} reach m, the largest size of a reading
 */
function scan(state, ahead, left, reach) {
  const heading = headingOf(state);
  const [cos, sin] = [Math.cos(heading), Math.sin(heading)];
  const { q, terrain } = state;
  return ahead.flatMap((x) =>
    left.map((y) => {
      const level = terrain?.heightAt(q[0] + cos * x - sin * y, q[1] + sin * x + cos * y) ?? 0;
      return clip(q[2] - state.standing - level, -reach, reach);
    }),
  );
}

/**
 * What a policy can observe, by the names in its metadata.
 * @type {Record<string, (state: State, parameters: any) => number | ArrayLike<number>>}
 */
export const OBSERVATIONS = {
  "observation:velocity": ({ R, v }) => toBody(R, v),
  "observation:angular_velocity": ({ v }) => Array.from(v).slice(3, 6),
  "observation:gravity": ({ R }) => [-R[6], -R[7], -R[8]],
  "observation:heading": (state) => headingOf(state),
  "observation:offset": ({ q }, { reach }) => clip(q[1], -reach, reach),
  "observation:command": ({ command }) => command,
  "observation:trot_clock": ({ command, steps }, { stride }) => {
    const moves = Number(Array.from(command).some((x) => x !== 0));
    const phase = (TAU * steps) / stride;
    return [moves * Math.sin(phase), moves * Math.sin(phase + Math.PI / 2)];
  },
  "observation:joint_pos": ({ q, home }) => home.map((angle, k) => q[7 + k] - angle),
  "observation:joint_vel": ({ v }) => Array.from(v).slice(6),
  "observation:last_action": ({ last }) => last,
  "observation:height": ({ q, terrain }) => q[2] - (terrain?.heightAt(q[0], q[1]) ?? 0),
  "observation:height_scan": (state, { length, width, spacing, reach }) =>
    scan(state, spread(length, spacing), spread(width, spacing), reach),
  "observation:scan_ahead": (state, { first, last, width, spacing, reach }) => {
    const ahead = spread(last - first, spacing).map((x) => (first + last) / 2 + x);
    return scan(state, ahead, spread(width, spacing), reach);
  },
  "observation:world_position": ({ q }) => Array.from(q).slice(0, 3),
  "observation:world_orientation": ({ q }) => [q[4], q[5], q[6], q[3]],
  "observation:world_velocity": ({ v }) => Array.from(v).slice(0, 3),
  "observation:world_angular_velocity": ({ R, v }) =>
    [0, 3, 6].map((row) => R[row] * v[3] + R[row + 1] * v[4] + R[row + 2] * v[5]),
  "observation:joint_angles": ({ q }) => Array.from(q).slice(7),
};

/**
 * Return a list of the metadata; null stands for a number without limit.
 * @param {string} text
 * @returns {number[]}
 */
export function readNumbers(text) {
  return JSON.parse(text).map((/** @type {number | null} */ value) => value ?? Infinity);
}

/**
 * Return the rows (9,) of the rotation from the frame of a unit quaternion wxyz to the world's.
 * @param {ArrayLike<number>} quat
 */
export function toMatrix(quat) {
  const [w, x, y, z] = Array.from(quat);
  return [
    1 - 2 * (y * y + z * z),
    2 * (x * y - w * z),
    2 * (x * z + w * y),
    2 * (x * y + w * z),
    1 - 2 * (x * x + z * z),
    2 * (y * z - w * x),
    2 * (x * z - w * y),
    2 * (y * z + w * x),
    1 - 2 * (x * x + y * y),
  ];
}

/** Draw a number from the normal distribution. */
function drawNormal() {
  return Math.sqrt(-2 * Math.log(1 - Math.random())) * Math.cos(TAU * Math.random());
}

/** The policy of one episode, and the joint controller that obeys it. */
export class Controller {
  /** @param {Policy} policy */
  constructor(policy) {
    this.policy = policy;
    const metadata = (this.metadata = policy.metadata);
    this.stiffness = readNumbers(metadata.joint_stiffness);
    this.damping = readNumbers(metadata.joint_damping);
    this.effort = readNumbers(metadata.effort_limit);
    this.speed = readNumbers(metadata.velocity_limit);
    this.friction = readNumbers(metadata.joint_friction);
    this.home = readNumbers(metadata.default_joint_pos);
    /** @type {string[]} */
    this.functions = JSON.parse(metadata.observation_functions);
    this.parameters = Object.values(JSON.parse(metadata.observation_params));
    this.history = readNumbers(metadata.observation_history).map((steps) => steps + 1);
    this.noise = readNumbers(metadata.observation_noise ?? "[]");
    this.standing = readNumbers(metadata.start_qpos)[2];
    /** @type {number[][][]} the last readings of each part, oldest first */
    this.past = [];
    /** @type {ArrayLike<number>} */
    this.action = [];
    this.steps = 0;
    this.restart();
  }

  /** Throw an error for a policy whose observation this page cannot compute. */
  checkObservations() {
    const unknown = this.functions.filter((name) => !(name in OBSERVATIONS));
    if (unknown.length) throw new Error(`this page cannot compute ${unknown.join(", ")}`);
  }

  /** Start an episode: no step is done, and none is remembered. */
  restart() {
    this.past = this.history.map(() => []);
    this.action = new Float32Array(12);
    this.steps = 0;
  }

  /**
   * Return the observation of a control step, after it has joined the history.
   * @param {ArrayLike<number>} q (19,)
   * @param {ArrayLike<number>} v (18,)
   * @param {ArrayLike<number>} command (3,)
   * @param {Terrain | null} terrain
   * @param {number} noise level of the sensors' noise; 1 is what the policy was trained with
   */
  observe(q, v, command, terrain = null, noise = 0) {
    const { home, standing, steps } = this;
    const R = toMatrix(Array.from(q).slice(3, 7));
    /** @type {State} */
    const state = { R, q, v, home, last: this.action, command, steps, standing, terrain };
    this.functions.forEach((name, part) => {
      const value = OBSERVATIONS[name](state, this.parameters[part]);
      const reading = typeof value === "number" ? [value] : Array.from(value);
      const spread = noise * (this.noise[part] ?? 0);
      if (spread) reading.forEach((x, k) => (reading[k] = x + spread * drawNormal()));
      const readings = this.past[part];
      do readings.push(reading);
      while (readings.length < this.history[part]);
      if (readings.length > this.history[part]) readings.shift();
    });
    return Float32Array.from(this.past.flat(2));
  }

  /**
   * Return the joint targets (12,), rad, of a control step; keep its observation and action.
   * @param {ArrayLike<number>} q (19,)
   * @param {ArrayLike<number>} v (18,)
   * @param {ArrayLike<number>} command (3,)
   * @param {Terrain | null} [terrain]
   * @param {number} [noise]
   */
  computeTargets(q, v, command, terrain = null, noise = 0) {
    this.obs = this.observe(q, v, command, terrain, noise);
    const { action, target } = this.policy.run({
      obs: this.obs,
      joint_pos: Float32Array.from(Array.from(q).slice(7)),
    });
    this.action = action;
    this.steps += 1;
    return target;
  }

  /**
   * Write the joint torques (12,), Nm, of a physics step: the motors' and joint friction's.
   * @param {ArrayLike<number>} target (12,) rad
   * @param {ArrayLike<number>} q (19,)
   * @param {ArrayLike<number>} v (18,)
   * @param {number} strength factor of the motors' torque
   * @param {Float64Array} torque where it is written, from its element 6 on
   */
  applyTorque(target, q, v, strength, torque) {
    for (let joint = 0; joint < 12; joint++) {
      const speed = v[6 + joint];
      const effort = strength * this.effort[joint];
      const upper = effort * clip(1 - speed / this.speed[joint], 0, 1);
      const lower = -effort * clip(1 + speed / this.speed[joint], 0, 1);
      const pull = this.stiffness[joint] * (target[joint] - q[7 + joint]);
      const motor = clip(pull - this.damping[joint] * speed, lower, upper);
      torque[6 + joint] = motor - this.friction[joint] * Math.tanh(speed / FRICTION_SPEED);
    }
  }
}
