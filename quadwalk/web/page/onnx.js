/**
 * Read and run a policy in ONNX: the few operators that quadwalk's exports use.
 *
 * The file is a protocol buffer; its field numbers are those of onnx.proto.
 */

/**
 * @typedef {{name: string, shape: number[], values: Float32Array}} Tensor
 * @typedef {{operator: string, inputs: string[], output: string}} Node
 */

const FLOAT = 1;
const INT64 = 7;

/**
 * Yield the fields of a protocol buffer message.
 * @param {Uint8Array} bytes
 * @returns {Generator<[number, number | Uint8Array]>} field number, and its integer or its bytes
 */
function* readFields(bytes) {
  const view = new DataView(bytes.buffer, bytes.byteOffset, bytes.byteLength);
  let at = 0;
  const readInteger = () => {
    let value = 0;
    let factor = 1;
    for (;;) {
      const byte = bytes[at++];
      if (byte === undefined) throw new Error("the policy's file ends in the middle");
      value += (byte & 127) * factor;
      if (byte < 128) return value;
      factor *= 128;
    }
  };
  while (at < bytes.length) {
    const key = readInteger();
    const field = Math.floor(key / 8);
    const kind = key % 8;
    if (kind === 0) {
      yield [field, readInteger()];
    } else if (kind === 2) {
      const size = readInteger();
      yield [field, bytes.subarray(at, at + size)];
      at += size;
    } else if (kind === 5) {
      yield [field, view.getFloat32(at, true)];
      at += 4;
    } else {
      throw new Error("the policy is not a file in ONNX");
    }
  }
}

/** @param {number | Uint8Array} value */
function toText(value) {
  return new TextDecoder().decode(/** @type {Uint8Array} */ (value));
}

/**
 * Return the fields with this number, as bytes.
 * @param {Uint8Array} message
 * @param {number} number
 * @returns {Uint8Array[]}
 */
function findFields(message, number) {
  const values = [];
  for (const [field, value] of readFields(message)) {
    if (field === number) values.push(/** @type {Uint8Array} */ (value));
  }
  return values;
}

/** @param {Uint8Array} message a TensorProto @returns {Tensor} */
function readTensor(message) {
  const shape = [];
  let name = "";
  let type = FLOAT;
  let raw = new Uint8Array();
  for (const [field, value] of readFields(message)) {
    if (field === 1 && typeof value === "number") shape.push(value);
    else if (field === 1) shape.push(.../** @type {Uint8Array} */ (value));
    else if (field === 2) type = /** @type {number} */ (value);
    else if (field === 8) name = toText(value);
    else if (field === 9) raw = /** @type {Uint8Array} */ (value).slice();
  }
  if (type === INT64) {
    const values = Float32Array.from(new BigInt64Array(raw.buffer), Number);
    return { name, shape, values };
  }
  return { name, shape, values: new Float32Array(raw.buffer) };
}

/** @param {Uint8Array} message a NodeProto @returns {Node} */
function readNode(message) {
  return {
    operator: toText(findFields(message, 4)[0]),
    inputs: findFields(message, 1).map(toText),
    output: toText(findFields(message, 2)[0]),
  };
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
  /** @param {Uint8Array} file */
  constructor(file) {
    const [graph] = findFields(file, 7);
    if (!graph) throw new Error("the policy is not a file in ONNX");
    /** @type {Record<string, string>} */
    this.metadata = {};
    for (const entry of findFields(file, 14)) {
      this.metadata[toText(findFields(entry, 1)[0])] = toText(findFields(entry, 2)[0] ?? []);
    }
    this.inputs = findFields(graph, 11).map((info) => toText(findFields(info, 1)[0]));
    this.nodes = findFields(graph, 1).map(readNode);
    const unknown = this.nodes.find((node) => !(node.operator in OPERATORS));
    if (unknown) throw new Error(`the policy uses the operator ${unknown.operator}, unknown here`);
    this.constants = new Map(
      findFields(graph, 5).map((message) => {
        const tensor = readTensor(message);
        return [tensor.name, tensor];
      }),
    );
  }

  /**
   * Compute actions (12,) and joint targets (12,), rad.
   * @param {Record<string, Float32Array>} inputs by their names
   */
  run(inputs) {
    /** @type {Map<string, Tensor>} */
    const tensors = new Map(this.constants);
    for (const name of this.inputs) {
      tensors.set(name, { name, shape: [1, inputs[name].length], values: inputs[name] });
    }
    for (const node of this.nodes) {
      const values = OPERATORS[node.operator](
        ...node.inputs.map((name) => /** @type {Tensor} */ (tensors.get(name))),
      );
      tensors.set(node.output, { name: node.output, shape: [1, values.length], values });
    }
    const output = (/** @type {string} */ name) => /** @type {Tensor} */ (tensors.get(name)).values;
    return { action: output("actions"), target: output("joint_targets") };
  }
}
