/** The program that serves the page, where one is: it sends new policies, and acts for some. */

/**
 * @typedef {object} Events
 * @property {(file: Uint8Array) => void} onPolicy
 * @property {(message: any) => void} onTraining of a training whose numbers can be changed
 * @property {() => void} onStart
 * @property {() => void} onEnd
 */

const RETRY = 2000; // ms after a connection has ended

/** A connection to the program that serves the page. */
export class Server {
  /** @param {Events} events */
  constructor(events) {
    this.events = events;
    this.isReady = true;
    /** @type {Float64Array | null} */
    this.targets = null;
    this.socket = this.connect();
  }

  /** Return a new connection; once it has ended, as where the page was too busy, try again. */
  connect() {
    const { onPolicy, onTraining, onStart, onEnd } = this.events;
    const socket = new WebSocket(`${location.origin.replace(/^http/, "ws")}/live`);
    socket.binaryType = "arraybuffer";
    socket.addEventListener("message", ({ data }) => {
      if (data instanceof ArrayBuffer) return onPolicy(new Uint8Array(data));
      const message = JSON.parse(data);
      if (!Array.isArray(message)) return onTraining(message);
      this.targets = Float64Array.from(message);
      this.isReady = true;
    });
    socket.addEventListener("open", () => {
      this.isReady = true;
      onStart();
    });
    socket.addEventListener("close", () => {
      onEnd();
      setTimeout(() => (this.socket = this.connect()), RETRY);
    });
    return socket;
  }

  /** @param {any} message */
  send(message) {
    if (this.socket.readyState === WebSocket.OPEN) this.socket.send(JSON.stringify(message));
  }

  /**
   * Return the joint targets (12,), rad, of a state once they have come; null while they are asked.
   * @param {import("./simulation.js").Simulation} simulation
   * @param {number[]} command (3,)
   */
  askTargets({ time, data }, command) {
    const { targets } = this;
    this.targets = null;
    if (targets || !this.isReady) return targets;
    this.isReady = false;
    const state = { time, qpos: Array.from(data.qpos), qvel: Array.from(data.qvel), command };
    this.send(state);
    return null;
  }
}
