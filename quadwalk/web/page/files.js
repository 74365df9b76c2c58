/** Where the page's files are: beside it on a server, or inside it. */

import startMujoco from "@mujoco/mujoco";

import { unpack } from "./terrain.js";

/**
 * Files inside a page that is one file: gzip in base64, by name.
 * @type {Record<string, string> | undefined}
 */
const inside = /** @type {any} */ (globalThis).QUADWALK_FILES;

/** Return true if the page is one file. */
export const isSingleFile = inside !== undefined;

/**
 * Read a file of the page.
 * @param {string} name
 * @returns {Promise<Uint8Array>}
 */
export async function readFile(name) {
  if (inside) return unpack(inside[name]);
  const address = name.split("/").map(encodeURIComponent).join("/");
  const answer = await fetch(address, { cache: "no-cache" });
  if (!answer.ok) throw new Error(answer.status === 500 ? await answer.text() : `no ${name} here`);
  if (!name.endsWith(".gz")) return new Uint8Array(await answer.arrayBuffer());
  const body = /** @type {ReadableStream} */ (answer.body);
  const stream = body.pipeThrough(new DecompressionStream("gzip"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** @param {string} name */
export async function readText(name) {
  return new TextDecoder().decode(await readFile(name));
}

/** Start MuJoCo's WebAssembly module. */
export async function loadMujoco() {
  const wasmBinary = await readFile("vendor/mujoco.wasm.gz");
  return startMujoco({ wasmBinary, locateFile: (/** @type {string} */ file) => file });
}
