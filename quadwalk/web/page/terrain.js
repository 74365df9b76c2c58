/** Uneven ground: heights on a grid, laid in place of the model's floor. */

/**
 * @typedef {object} Tile
 * @property {string} kind
 * @property {number} difficulty 0 to 1
 * @property {[number, number]} start m, where a robot starts
 *
 * @typedef {object} TerrainFile
 * @property {number} rows along y
 * @property {number} columns along x
 * @property {number} cell m between nodes
 * @property {[number, number]} origin m, x and y of the first node
 * @property {number} low m, the lowest height
 * @property {number} step m, a unit of the heights
 * @property {string} heights uint16, row by row, packed by gzip, in base64
 * @property {Tile[]} tiles
 */

const BASE = 1; // m, how far the ground goes down below its lowest point

/**
 * Unpack bytes from gzip in base64.
 * @param {string} text
 */
export async function unpack(text) {
  const packed = Uint8Array.from(atob(text), (character) => character.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("gzip"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** Heights over a grid of square cells, each two triangles as in MuJoCo. */
export class Terrain {
  /** @param {TerrainFile} file */
  static async read(file) {
    const bytes = await unpack(file.heights);
    const units = new Uint16Array(bytes.buffer, 0, file.rows * file.columns);
    return new Terrain(file, units);
  }

  /**
   * @param {TerrainFile} file
   * @param {ArrayLike<number>} units heights in units of the file's step
   */
  constructor(file, units) {
    this.file = file;
    this.tiles = file.tiles;
    this.heights = Float64Array.from(units, (unit) => file.low + file.step * unit);
    const top = this.heights.reduce((highest, height) => Math.max(highest, height), file.low);
    this.range = Math.max(top - file.low, 1e-3);
    const [x, y] = file.origin;
    /** The edges of the field, m: least x, most x, least y, most y. */
    this.edges = [x, x + (file.columns - 1) * file.cell, y, y + (file.rows - 1) * file.cell];
  }

  /**
   * Return the height, m, at a point; beyond an edge, that of the edge.
   * @param {number} x m
   * @param {number} y m
   */
  heightAt(x, y) {
    const { columns, rows, cell, origin } = this.file;
    const across = Math.min(Math.max((x - origin[0]) / cell, 0), columns - 1);
    const along = Math.min(Math.max((y - origin[1]) / cell, 0), rows - 1);
    const j = Math.min(Math.floor(across), columns - 2);
    const i = Math.min(Math.floor(along), rows - 2);
    const [u, v] = [across - j, along - i];
    const node = i * columns + j;
    const h = this.heights;
    const third = u > v ? h[node + 1] : h[node + columns];
    const [first, last] = [Math.max(u, v), Math.min(u, v)];
    return h[node] * (1 - first) + third * (first - last) + h[node + columns + 1] * last;
  }

  /**
   * Return true if a point is less than this margin from an edge of the field, or beyond it.
   * @param {number} x m
   * @param {number} y m
   * @param {number} margin m
   */
  isAtEdge(x, y, margin) {
    const [left, right, low, high] = this.edges;
    return x < left + margin || x > right - margin || y < low + margin || y > high - margin;
  }

  /**
   * Return a robot's MJCF with this ground in place of its flat floor.
   * @param {string} xml
   */
  layInto(xml) {
    const { rows, columns, cell, origin, low } = this.file;
    const [length, width] = [(columns - 1) * cell, (rows - 1) * cell];
    const size = `${length / 2} ${width / 2} ${this.range} ${BASE}`;
    const field = `<hfield name="floor" nrow="${rows}" ncol="${columns}" size="${size}"/>`;
    const position = `${origin[0] + length / 2} ${origin[1] + width / 2} ${low}`;
    return xml
      .replace("</asset>", `${field}</asset>`)
      .replace(/(<geom name="floor") size="[^"]*" type="plane"/, (_, start) => {
        return `${start} type="hfield" hfield="floor" pos="${position}"`;
      });
  }

  /**
   * Write the heights into a model made from `layInto`.
   * @param {any} model
   */
  fill(model) {
    const { low } = this.file;
    model.hfield_data.set(Float32Array.from(this.heights, (height) => (height - low) / this.range));
  }
}
