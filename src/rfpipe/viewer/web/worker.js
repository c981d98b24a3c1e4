// A worker: stores its share of a program's operations in one memory, and runs them on light.
// Messages: {start}, {array, data}, {run}; answers: {loaded}, {picture}, {failed}.
const TYPES = { i4: Int32Array, f4: Float32Array, u1: Uint8Array, u2: Uint16Array };
const aligned = (bytes) => (bytes + 15) & ~15;
let about, own, kernels, memory, F, I, top = 0;
let buffers, counts;
const raw = new Map(), uses = new Map(), placed = new Map();

function allocate(bytes) {
  const at = top;
  top += aligned(bytes);
  return at;
}

const length = (array) => array.shape.reduce((product, size) => product * size, 1);

// Bytes of an operation's numbers; arrays of several operations are counted once.
function needed() {
  let bytes = 0;
  const seen = new Set(), sizes = new Set();
  for (const op of own) {
    sizes.add(op.source).add(op.target);
    for (const [name, index] of Object.entries(op.arrays)) {
      if (op.kind === "leaves") {
        if (name === "values" || name === "codes" || name === "scales") {
          bytes += aligned(4 * length(about.arrays[index]));
        }
      } else if (!seen.has(index)) {
        seen.add(index);
        bytes += aligned(4 * length(about.arrays[index]));
      }
    }
    if (op.kind === "leaves") {
      const n = length(about.arrays[op.arrays.block_a]);
      bytes += aligned(16 * n) + 2 * aligned(4 * op.entries);
      bytes += aligned(4 * op.entries * about.channels);
    }
  }
  let largest = 0;
  for (const buffer of sizes) {
    bytes += aligned(4 * about.channels * about.buffers[buffer]);
    largest = Math.max(largest, about.buffers[buffer]);
  }
  return { bytes: bytes + aligned(4 * (largest + 1)) + 64, used: sizes, largest };
}

async function start({ manifest, operations, wasm }) {
  about = manifest;
  own = operations.map((index) => ({ ...manifest.operations[index], ready: false }));
  for (const op of own) {
    for (const index of Object.values(op.arrays)) uses.set(index, (uses.get(index) || 0) + 1);
  }
  const { bytes, used, largest } = needed();
  if (wasm) {
    memory = new WebAssembly.Memory({ initial: Math.ceil(bytes / 65536) + 1 });
    const made = await WebAssembly.instantiate(wasm, { env: { memory } });
    kernels = made.instance.exports;
  } else {
    memory = { buffer: new ArrayBuffer(bytes) };
    kernels = plainKernels(memory.buffer);
  }
  F = new Float32Array(memory.buffer);
  I = new Int32Array(memory.buffer);
  buffers = new Map([...used].map((n) => [n, allocate(4 * about.channels * about.buffers[n])]));
  counts = allocate(4 * (largest + 1));
}

// From base64 of bytes as program.py packed them to numbers.
async function decoded(array, data) {
  const stream = new Blob([fromBase64(data)]).stream().pipeThrough(new DecompressionStream("gzip"));
  const planes = new Uint8Array(await new Response(stream).arrayBuffer());
  const Type = TYPES[array.type], size = Type.BYTES_PER_ELEMENT, n = planes.length / size;
  if (size === 1) return new Type(planes.buffer);
  const bytes = new Uint8Array(planes.length);
  for (let byte = 0; byte < size; byte++) {
    for (let i = 0, at = byte * n, to = byte; i < n; i++, at++, to += size) bytes[to] = planes[at];
  }
  const numbers = new Type(bytes.buffer);
  if (Type === Int32Array) for (let i = 1; i < n; i++) numbers[i] += numbers[i - 1];
  return numbers;
}

function fromBase64(text) {
  if (Uint8Array.fromBase64) return Uint8Array.fromBase64(text);
  const binary = atob(text), bytes = new Uint8Array(binary.length);
  for (let i = 0; i < bytes.length; i++) bytes[i] = binary.charCodeAt(i);
  return bytes;
}

async function receive({ array, data }) {
  if (!uses.has(array)) return;
  raw.set(array, await decoded(about.arrays[array], data));
  for (const op of own) {
    if (!op.ready && Object.values(op.arrays).every((index) => raw.has(index))) prepare(op);
  }
}

function prepare(op) {
  if (op.kind === "leaves") prepareLeaves(op);
  else for (const index of Object.values(op.arrays)) place(index);
  op.ready = true;
  for (const index of Object.values(op.arrays)) {
    uses.set(index, uses.get(index) - 1);
    if (!uses.get(index)) raw.set(index, null);
  }
}

// Lay an array of 32-bit numbers into the memory, once.
function place(index) {
  if (placed.has(index)) return;
  const numbers = raw.get(index), at = allocate(4 * numbers.length);
  (numbers instanceof Int32Array ? I : F).set(numbers, at >> 2);
  placed.set(index, at);
}

function prepareLeaves(op) {
  const get = (name) => (name in op.arrays ? raw.get(op.arrays[name]) : null);
  const a = get("block_a"), b = get("block_b"), sizes = get("sizes"), { channels } = about;
  const starts = new Int32Array(sizes.length + 1);
  for (let i = 0; i < sizes.length; i++) starts[i + 1] = starts[i] + sizes[i];
  const count = a.length, ends = new Int32Array(count + 1);
  for (let i = 0; i < count; i++) {
    ends[i + 1] = ends[i] + sizes[a[i]] + (a[i] === b[i] ? 0 : sizes[b[i]]);
  }
  const total = ends[count], codes = get("codes");
  const factors = codes ? decodedFactors(codes, get("scales"), ends) : get("values");
  const isShort = (i) => {
    const na = sizes[a[i]], nb = sizes[b[i]];
    return (a[i] === b[i] ? na * (na + 1) / 2 : na * nb) <= about.short;
  };
  const long = [], short = [];
  for (let i = 0; i < count; i++) (isShort(i) ? short : long).push(i);
  const numbers = long.reduce((sum, i) => sum + ends[i + 1] - ends[i], 0);
  Object.assign(op, { n: long.length, stride: numbers, table: allocate(16 * long.length),
    values: allocate(4 * numbers * channels) });
  long.forEach((i, k) => {
    const nb = a[i] === b[i] ? 0 : sizes[b[i]];
    I.set([starts[a[i]], sizes[a[i]], starts[b[i]], nb], (op.table >> 2) + 4 * k);
  });
  for (let channel = 0; channel < channels; channel++) {
    let to = (op.values >> 2) + channel * numbers;
    long.forEach((i) => {
      F.set(factors.subarray(channel * total + ends[i], channel * total + ends[i + 1]), to);
      to += ends[i + 1] - ends[i];
    });
  }
  prepareEntries(op, short, { a, b, sizes, starts, ends, factors });
}

// Leaves over few rays as pairs of rays.
function prepareEntries(op, short, { a, b, sizes, starts, ends, factors }) {
  const { channels } = about, n = op.entries, total = ends[ends.length - 1];
  op.pairs = { first: allocate(4 * n), second: allocate(4 * n), values: allocate(4 * n * channels) };
  let to = 0;
  for (const i of short) {
    const na = sizes[a[i]], nb = sizes[b[i]], same = a[i] === b[i], at = ends[i];
    const other = same ? at : at + na;
    for (let row = 0; row < na; row++) {
      for (let column = same ? row : 0; column < nb; column++, to++) {
        I[(op.pairs.first >> 2) + to] = starts[a[i]] + row;
        I[(op.pairs.second >> 2) + to] = starts[b[i]] + column;
        for (let channel = 0; channel < channels; channel++) {
          F[(op.pairs.values >> 2) + channel * n + to] =
            factors[channel * total + at + row] * factors[channel * total + other + column];
        }
      }
    }
  }
}

// A factor is its code squared times its leaf's scale; later channels are differences to the first.
function decodedFactors(codes, scales, ends) {
  const n = ends.length - 1, total = ends[n], mask = codes.BYTES_PER_ELEMENT === 1 ? 255 : 65535;
  const factors = new Float32Array(about.channels * total);
  for (let channel = 0; channel < about.channels; channel++) {
    for (let leaf = 0; leaf < n; leaf++) {
      const scale = scales[channel * n + leaf];
      for (let k = ends[leaf]; k < ends[leaf + 1]; k++) {
        let code = codes[k];
        if (channel) {
          const folded = codes[channel * total + k];
          code = (((folded >> 1) ^ -(folded & 1)) + code) & mask;
        }
        factors[channel * total + k] = code * code * scale;
      }
    }
  }
  return factors;
}

function run({ light, colour, dual, level, parts }) {
  const channels = about.channels, given = dual ? 1 : 0, taken = dual ? 0 : 1;
  for (const [n, at] of buffers) F.fill(0, at >> 2, (at >> 2) + channels * about.buffers[n]);
  const rays = about.buffers[given];
  if (buffers.has(given)) {
    for (let channel = 0; channel < channels; channel++) {
      const from = light.length > rays ? channel * rays : 0, weight = colour[channel];
      const to = (buffers.get(given) >> 2) + channel * rays;
      for (let i = 0; i < rays; i++) F[to + i] = light[from + i] * weight;
    }
  }
  const chosen = own.filter((op) => op.ready && (op.part < 0 || parts[op.part]) && op.levels.includes(level));
  if (dual) chosen.reverse();
  let counted = -1;
  for (const op of chosen) {
    const [source, sourceAt] = dual ? [op.target, op.target_at] : [op.source, op.source_at];
    const [target, targetAt] = dual ? [op.source, op.source_at] : [op.target, op.target_at];
    if (op.kind === "leaves" && counted !== source) {
      kernels.count_lit(about.buffers[source], channels, buffers.get(source), counts);
      counted = source;
    }
    for (let channel = 0; channel < channels; channel++) {
      const x = buffers.get(source) + 4 * (channel * about.buffers[source] + sourceAt);
      const y = buffers.get(target) + 4 * (channel * about.buffers[target] + targetAt);
      apply(op, channel, op.transposed !== dual, x, y);
    }
  }
  const size = channels * about.buffers[taken];
  if (!buffers.has(taken)) return new Float32Array(size);
  const at = buffers.get(taken) >> 2;
  return F.slice(at, at + size);
}

function apply(op, channel, transposed, x, y) {
  if (op.kind === "leaves") {
    const { first, second, values: entries } = op.pairs;
    kernels.leaves(op.n, op.table, op.values + 4 * channel * op.stride, x, y, counts);
    kernels.pairs(op.entries, first, second, entries + 4 * channel * op.entries, x, y);
    return;
  }
  const at = (name) => placed.get(op.arrays[name]);
  const size = (name) => length(about.arrays[op.arrays[name]]);
  const suffix = transposed ? "_transposed" : "";
  if (op.kind === "gather") {
    kernels["gather" + suffix](size("index"), at("index"), x, y);
    return;
  }
  const { shape } = about.arrays[op.arrays.values];
  const plane = shape.slice(1).reduce((product, size) => product * size, 1);
  const values = at("values") + (shape[0] > 1 ? 4 * channel * plane : 0);
  if (op.kind === "scale") kernels.scale(plane, values, x, y);
  else if (op.kind === "pairs") kernels.pairs(plane, at("first"), at("second"), values, x, y);
  else if (op.kind === "csr") {
    kernels["csr" + suffix](size("counts"), at("counts"), at("columns"), values, x, y);
  } else kernels["dense" + suffix](shape[1], shape[2], values, x, y);
}

// Process messages in order, although some are asynchronous.
let before = Promise.resolve();
onmessage = ({ data }) => {
  before = before.then(async () => {
    if (data.start) await start(data.start);
    else if (data.run) {
      const picture = run(data.run);
      postMessage({ picture, id: data.run.id }, [picture.buffer]);
    } else {
      await receive(data);
      postMessage({ loaded: data.array });
    }
  }).catch((error) => postMessage({ failed: String(error && error.stack || error) }));
};
