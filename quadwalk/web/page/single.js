/** Start a page that is one file: unpack its modules, dependencies first, and import the last. */

(async () => {
  /** @type {any} */
  const { QUADWALK_FILES: files, QUADWALK_MODULES: modules, QUADWALK_PLACES: places } = globalThis;
  const unpack = async (/** @type {string} */ text) => {
    const packed = Uint8Array.from(atob(text), (character) => character.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
    return new Response(stream).text();
  };
  /** @type {Record<string, string>} */
  const urls = {};
  for (const name of modules) {
    const source = await unpack(files[name]);
    const linked = source.replace(/(from\s*)["']([^"']+)["']/g, (all, from, target) => {
      const url = urls[places[target] ?? target.replace("./", "")];
      return url ? `${from}"${url}"` : all;
    });
    const blob = new Blob([linked], { type: "text/javascript" });
    urls[name] = URL.createObjectURL(blob);
  }
  await import(urls["main.js"]);
})();
