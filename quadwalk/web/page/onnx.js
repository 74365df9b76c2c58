/** Run a policy in ONNX: the few operators that quadwalk's exports use. */

/** @typedef {{name: string, shape: number[], values: Float32Array}} Tensor */

const INT64 = 7; // ONNX's number of a type; all other tensors are of float32

/**
 * Return a tensor of the file.
 * @param {{name: string, dims?: string[], dataType: number, rawData: string}} tensor
 * @returns {Tensor}
 */
function readTensor({ name, dims = [], dataType, rawData }) {
  const { buffer } = Uint8Array.from(atob(rawData), (character) => character.charCodeAt(0));
  const values =
    dataType === INT64
      ? Float32Array.from(new BigInt64Array(buffer), Number)
      : new Float32Array(buffer);
  return { name, shape: dims.map(Number), values };
}

/**
 * Apply a function to each number; a tensor of one number serves for all.
 * @param {(x: number, y: number, z: number) => number} f
 * @returns {(...inputs: Tensor[]) => Float32Array}
 */
function elementwise(f) {
  return (...inputs) => {
    const size = Math.max(...inputs.map((tensor) => tensor.values.length));
    const [x, y, z] = [0, 1, 2].map((k) => (inputs[k] ?? inputs[0]).values);
    const at = (/** @type {Float32Array} */ v, /** @type {number} */ i) => v[v.length > 1 ? i : 0];
    return Float32Array.from({ length: size }, (_, i) => f(at(x, i), at(y, i), at(z, i)));
  };
}

/**
 * Return x @ matrix + bias.
 * @param {Tensor} x (1, n)
 * @param {Tensor} matrix (n, m)
 * @param {Tensor} [bias] (m,)
 */
function multiply(x, matrix, bias) {
  const [rows, columns] = matrix.shape;
  const { values } = matrix;
  const sums = new Float64Array(columns);
  if (bias) sums.set(bias.values);
  for (let row = 0, at = 0; row < rows; row++) {
    const factor = x.values[row];
    for (let column = 0; column < columns; column++, at++) sums[column] += factor * values[at];
  }
  return Float32Array.from(sums);
}

/** @type {Record<string, (...inputs: Tensor[]) => Float32Array>} */
const OPERATORS = {
  Add: elementwise((x, y) => x + y),
  Div: elementwise((x, y) => x / y),
  Elu: elementwise((x) => (x > 0 ? x : Math.exp(x) - 1)),
  Gather: (x, order) => Float32Array.from(order.values, (index) => x.values[index]),
  Gemm: multiply,
  Greater: elementwise((x, y) => Number(x > y)),
  MatMul: multiply,
  Max: elementwise(Math.max),
  Min: elementwise(Math.min),
  Mul: elementwise((x, y) => x * y),
  Relu: elementwise((x) => Math.max(x, 0)),
  Sigmoid: elementwise((x) => 1 / (1 + Math.exp(-x))),
  Sin: elementwise(Math.sin),
  Softplus: elementwise((x) => Math.max(x, 0) + Math.log1p(Math.exp(-Math.abs(x)))),
  Sub: elementwise((x, y) => x - y),
  Tanh: elementwise(Math.tanh),
  Where: elementwise((condition, x, y) => (condition ? x : y)),
};

/** A policy, as exported. */
export class Policy {
  /** @param {Uint8Array} file ONNX in the JSON of protocol buffers */
  constructor(file) {
    const { graph, metadataProps } = JSON.parse(new TextDecoder().decode(file));
    /** @type {Record<string, string>} */
    this.metadata = {};
    for (const { key, value = "" } of metadataProps) this.metadata[key] = value;
    /** @type {string[]} */
    this.inputs = graph.input.map((/** @type {{name: string}} */ { name }) => name);
    /** @type {{opType: string, input: string[], output: string[]}[]} */
    this.nodes = graph.node;
    const unknown = this.nodes.find(({ opType }) => !(opType in OPERATORS));
    if (unknown) throw new Error(`the policy uses the operator ${unknown.opType}, unknown here`);
    /** @type {Tensor[]} */
    this.constants = graph.initializer.map(readTensor);
  }

  /**
   * Compute actions (12,) and joint targets (12,), rad.
   * @param {Record<string, Float32Array>} inputs by their names
   */
  run(inputs) {
    /** @type {Map<string, Tensor>} */
    const tensors = new Map(this.constants.map((tensor) => [tensor.name, tensor]));
    for (const name of this.inputs) {
      tensors.set(name, { name, shape: [1, inputs[name].length], values: inputs[name] });
    }
    for (const { opType, input, output } of this.nodes) {
      const [name] = output;
      const values = OPERATORS[opType](
        ...input.map((from) => /** @type {Tensor} */ (tensors.get(from))),
      );
      tensors.set(name, { name, shape: [1, values.length], values });
    }
    const output = (/** @type {string} */ name) => /** @type {Tensor} */ (tensors.get(name)).values;
    return { action: output("actions"), target: output("joint_targets") };
  }
}
