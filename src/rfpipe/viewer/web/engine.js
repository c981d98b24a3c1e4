// Workers that run a program: each runs a share of the operations, and their pictures are added.
class Engine {
  // `blob(i)` gives the i-th array's base64 text, or a promise of it.
  constructor(manifest, blob, count, simd) {
    this.about = manifest;
    this.blob = blob;
    this.loaded = new Set();
    this.onlevel = () => {};
    this.onfail = () => {};
    this.id = 0;
    this.waiting = new Map();
    this.busy = null;
    const shares = shareOut(manifest, count);
    const source = WORKER_SOURCE;
    const url = URL.createObjectURL(new Blob([source], { type: "text/javascript" }));
    const { operations, ...rest } = manifest;
    this.workers = shares.filter((share) => share.length).map((share) => {
      const worker = new Worker(url);
      const own = share.map((index) => operations[index]);
      const manifest = { ...rest, operations: own };
      worker.postMessage({ start: { manifest, operations: own.map((_, i) => i), wasm: simd } });
      worker.needs = new Set(own.flatMap((op) => Object.values(op.arrays)));
      worker.onmessage = ({ data }) => this.receive(worker, data);
      worker.onerror = (event) => this.onfail(event.message || "a worker stopped");
      return worker;
    });
    this.pending = new Map();
  }

  // Fetch the arrays, coarse ones first, and hand each to the workers that need it.
  async load() {
    for (let index = 0; index < this.about.arrays.length; index++) {
      const data = await this.blob(index);
      const users = this.workers.filter((worker) => worker.needs.has(index));
      this.pending.set(index, users.length);
      for (const worker of users) worker.postMessage({ array: index, data });
    }
  }

  receive(worker, data) {
    if (data.failed) this.onfail(data.failed);
    else if ("loaded" in data) {
      this.pending.set(data.loaded, this.pending.get(data.loaded) - 1);
      if (!this.pending.get(data.loaded)) {
        this.loaded.add(data.loaded);
        this.onlevel(this.ready());
      }
    } else if (this.busy && data.id === this.busy.id) this.collect(data.picture);
  }

  // Levels that are loaded.
  ready() {
    return this.about.levels.filter((level) => this.about.operations.every((op) =>
      !op.levels.includes(level) || Object.values(op.arrays).every((i) => this.loaded.has(i))));
  }

  // Compute the picture under a light. Of several waiting requests for one purpose only the newest
  // is computed; the others return null.
  picture(request, purpose = "seen") {
    return new Promise((resolve) => {
      if (this.waiting.has(purpose)) this.waiting.get(purpose).resolve(null);
      this.waiting.set(purpose, { request, resolve });
      if (!this.busy) this.next();
    });
  }

  next() {
    if (!this.waiting.size) return;
    const [purpose, { request, resolve }] = this.waiting.entries().next().value;
    this.waiting.delete(purpose);
    this.busy = { id: ++this.id, left: this.workers.length, sum: null, resolve };
    for (const worker of this.workers) worker.postMessage({ run: { ...request, id: this.id } });
    if (!this.workers.length) this.collect(new Float32Array(0));
  }

  collect(picture) {
    const { busy } = this;
    if (!busy.sum) busy.sum = picture;
    else for (let i = 0; i < picture.length; i++) busy.sum[i] += picture[i];
    if (--busy.left > 0) return;
    this.busy = null;
    this.next(); // the workers continue while the page shows this picture
    busy.resolve(busy.sum);
  }
}

// Assign operations to workers: each to the worker with the least work, with its inputs.
function shareOut({ operations, levels }, count) {
  const shares = Array.from({ length: count }, () => new Set());
  const loads = shares.map(() => new Map(levels.map((level) => [level, 0])));
  const give = (worker, members, counted = members) => {
    for (const index of members) shares[worker].add(index);
    for (const index of counted) {
      for (const level of operations[index].levels) {
        loads[worker].set(level, loads[worker].get(level) + operations[index].work);
      }
    }
  };
  const idlest = (level) => loads.reduce(
    (best, load, worker) => (load.get(level) < loads[best].get(level) ? worker : best), 0);
  const chains = new Map();
  operations.forEach((op, index) => {
    if (!chains.has(op.chain)) chains.set(op.chain, []);
    chains.get(op.chain).push(index);
  });
  const total = (members) => members.reduce((sum, index) => sum + operations[index].work, 0);
  const isShared = (index) => operations[index].shared;
  const inTurn = [...chains.values()].sort(
    (a, b) => a.some(isShared) - b.some(isShared) || total(b) - total(a));
  for (const members of inTurn) {
    const shared = members.filter(isShared), others = members.filter((index) => !isShared(index));
    const last = operations[members[members.length - 1]].levels.at(-1);
    if (!shared.length) {
      give(idlest(last), members);
      continue;
    }
    shared.sort((a, b) => operations[b].work - operations[a].work);
    for (const index of shared) give(idlest(operations[index].levels.at(-1)), [index]);
    shares.forEach((share) => {
      if (shared.some((index) => share.has(index))) others.forEach((index) => share.add(index));
    });
  }
  return shares.map((share) => [...share].sort((a, b) => a - b));
}
