/** What a link carries: settings and a sequence of commands. */

/** @typedef {import("./simulation.js").Settings} Settings */

/**
 * Read the part of a link after "#".
 *
 * Settings are `name=number`; `do=1.5:0,0,0;3:1,0,0` are seconds and commands; `dog=NAME` chooses.
 * @param {string} hash
 */
export function readLink(hash) {
  const values = new URLSearchParams(hash.replace(/^#/, ""));
  /** @type {Record<string, number>} */
  const settings = {};
  for (const name of ["friction", "payload", "strength", "latency", "noise", "pushes"]) {
    const value = Number(values.get(name));
    if (values.has(name) && Number.isFinite(value)) settings[name] = value;
  }
  return {
    dog: values.get("dog"),
    ground: values.get("ground"),
    settings,
    script: readScript(values.get("do")),
  };
}

/**
 * Read a sequence of commands; what is none is left out.
 * @param {string | null} text
 * @returns {[number, number[]][]}
 */
function readScript(text) {
  const parts = (text ?? "").split(";").map((part) => {
    const [seconds, command = ""] = part.split(":");
    return /** @type {[number, number[]]} */ ([Number(seconds), command.split(",").map(Number)]);
  });
  return parts.filter(([seconds, command]) => {
    const numbers = [seconds, ...command];
    return command.length === 3 && seconds > 0 && numbers.every(Number.isFinite);
  });
}

/**
 * Write the part of a link after "#".
 * @param {string} dog
 * @param {string} ground
 * @param {Settings} settings
 * @param {Settings} defaults
 * @param {[number, number[]][]} script
 */
export function writeLink(dog, ground, settings, defaults, script) {
  const values = new URLSearchParams({ dog });
  if (ground !== "flat") values.set("ground", ground);
  for (const [name, value] of Object.entries(settings)) {
    if (value !== /** @type {any} */ (defaults)[name]) values.set(name, String(value));
  }
  const parts = script.map(
    ([seconds, command]) => `${seconds.toFixed(2)}:${command.map((x) => +x.toFixed(2)).join(",")}`,
  );
  if (parts.length) values.set("do", parts.join(";"));
  return `#${values}`;
}
