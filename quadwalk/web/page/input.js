/** Keyboard, gamepad and touch: what they hold and press. */

/** @typedef {import("./pilot.js").Pilot} Pilot */

/** @type {Record<string, string>} keys that are held, by their place on the keyboard */
const HELD = {
  KeyW: "ahead",
  ArrowUp: "ahead",
  KeyS: "back",
  ArrowDown: "back",
  KeyA: "turnLeft",
  ArrowLeft: "turnLeft",
  KeyD: "turnRight",
  ArrowRight: "turnRight",
  KeyQ: "left",
  KeyE: "right",
  ShiftLeft: "gallop",
  ShiftRight: "gallop",
};
/** @type {Record<string, string>} keys that act once a press */
const PRESSED = {
  Space: "stop",
  KeyT: "throw",
  KeyR: "reset",
  KeyK: "kick",
  KeyP: "pause",
  KeyC: "camera",
};
/** @type {Record<number, string>} buttons of a gamepad */
const BUTTONS = { 0: "stop", 1: "kick", 2: "throw", 3: "reset", 8: "camera", 9: "pause" };
const DEAD = 0.12; // share of a stick's way that counts as its middle

/** @param {EventTarget | null} target */
function isTyping(target) {
  return target instanceof HTMLInputElement && ["text", "number"].includes(target.type);
}

/** Hears keys, gamepad and touch for a pilot. */
export class Inputs {
  /** @param {() => Pilot} pilot @param {(action: string) => void} act called once a press */
  constructor(pilot, act) {
    this.pilot = pilot;
    this.act = act;
    /** @type {Set<number>} buttons of the gamepad that are down */
    this.down = new Set();
    this.hadStick = false;
    addEventListener("keydown", (event) => this.onKey(event, true), { capture: true });
    addEventListener("keyup", (event) => this.onKey(event, false), { capture: true });
    addEventListener("blur", () => this.pilot().releaseAll());
    document.addEventListener("visibilitychange", () => {
      if (document.hidden) this.pilot().releaseAll();
    });
  }

  /** @param {KeyboardEvent} event @param {boolean} isDown */
  onKey(event, isDown) {
    const held = HELD[event.code];
    if (!isDown) {
      if (held) this.pilot().hold(held, false);
      return;
    }
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const pressed = PRESSED[event.code];
    if (isTyping(event.target) && pressed !== "stop") return;
    if (!held && !pressed) return;
    event.preventDefault();
    if (event.repeat) return;
    if (event.target instanceof HTMLElement) event.target.blur();
    if (held) this.pilot().hold(held, true);
    else this.act(pressed);
  }

  /** Read the gamepad, once a frame. */
  readGamepad() {
    const pad = navigator.getGamepads?.().find((candidate) => candidate?.connected);
    if (!pad) return;
    const axis = (/** @type {number} */ k) => {
      const value = pad.axes[k] ?? 0;
      return Math.abs(value) < DEAD ? 0 : -value;
    };
    const asked = [axis(1), axis(0), axis(2)];
    const isPushed = asked.some((x) => x !== 0);
    if (isPushed || this.hadStick) this.pilot().steer(asked[0], asked[1], asked[2]);
    this.hadStick = isPushed;
    pad.buttons.forEach((button, k) => {
      if (button.pressed && !this.down.has(k) && k in BUTTONS) this.act(BUTTONS[k]);
      if (button.pressed) this.down.add(k);
      else this.down.delete(k);
    });
  }

  /**
   * Make a thumb stick of an element.
   * @param {HTMLElement} element with a knob as its only child
   * @param {(right: number, up: number) => void} push of shares of its way, -1 to 1
   */
  addStick(element, push) {
    const knob = /** @type {HTMLElement} */ (element.firstElementChild);
    const move = (/** @type {PointerEvent} */ event) => {
      const box = element.getBoundingClientRect();
      const half = box.width / 2;
      const x = (event.clientX - box.left - half) / half;
      const y = (event.clientY - box.top - half) / half;
      const size = Math.max(Math.hypot(x, y), 1);
      knob.style.transform = `translate(${(half * x) / size / 1.6}px, ${(half * y) / size / 1.6}px)`;
      const share = (/** @type {number} */ value) => (Math.abs(value) < DEAD ? 0 : value / size);
      push(share(x), share(-y));
    };
    const release = () => {
      knob.style.transform = "";
      push(0, 0);
    };
    element.addEventListener("pointerdown", (event) => {
      element.setPointerCapture(event.pointerId);
      move(event);
    });
    element.addEventListener("pointermove", (event) => {
      if (element.hasPointerCapture(event.pointerId)) move(event);
    });
    element.addEventListener("lostpointercapture", release);
  }
}
