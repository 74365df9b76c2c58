/** The program that serves the page, where one is: it sends new policies, and acts for some. */

/**
 * @typedef {object} Events
 * @property {(file: Uint8Array, about: string) => void} onPolicy
 * @property {() => void} onEnd
 */

/** A connection to the program that serves the page. */
export class Server {
  /** @param {Events} events */
  constructor(events) {
    this.socket = new WebSocket(`${location.origin.replace(/^http/, "ws")}/live`);
    this.isReady = true;
    /** @type {Float64Array | null} */
    this.targets = null;
    this.socket.addEventListener("message", ({ data }) => {
      const message = JSON.parse(data);
      if (message.type === "policy") {
        const file = Uint8Array.from(atob(message.file), (character) => character.charCodeAt(0));
        events.onPolicy(file, message.about);
      } else if (message.type === "targets") {
        this.targets = Float64Array.from(message.targets);
        this.isReady = true;
      }
    });
    this.socket.addEventListener("close", () => events.onEnd());
  }

  /**
   * Return the joint targets (12,), rad, of a state once they have come; null while they are asked.
   * @param {number} time s since the start
   * @param {any} data MuJoCo's
   * @param {number[]} command (3,)
   */
  askTargets(time, data, command) {
    const { targets } = this;
    this.targets = null;
    if (targets || !this.isReady || this.socket.readyState !== WebSocket.OPEN) return targets;
    this.isReady = false;
    const state = { time, qpos: Array.from(data.qpos), qvel: Array.from(data.qvel), command };
    this.socket.send(JSON.stringify({ type: "state", ...state }));
    return null;
  }
}
