/** The program that serves the page, where one is: it sends new policies, and acts for some. */

/** A connection to the program that serves the page. */
export class Server {
  /** @param {(file: Uint8Array) => void} onPolicy @param {() => void} onEnd */
  constructor(onPolicy, onEnd) {
    this.socket = new WebSocket(`${location.origin.replace(/^http/, "ws")}/live`);
    this.isReady = true;
    /** @type {Float64Array | null} */
    this.targets = null;
    this.socket.binaryType = "arraybuffer";
    this.socket.addEventListener("message", ({ data }) => {
      if (data instanceof ArrayBuffer) {
        onPolicy(new Uint8Array(data));
      } else {
        this.targets = Float64Array.from(JSON.parse(data));
        this.isReady = true;
      }
    });
    this.socket.addEventListener("close", onEnd);
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
    this.socket.send(JSON.stringify(state));
    return null;
  }
}
