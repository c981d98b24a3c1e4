// The page: its state, the two screens, and the loop that updates their pictures.
const $ = (id) => document.getElementById(id);
const ORDER = ["projector", "camera"];
const sides = { projector: new Side(MANIFEST.projector), camera: new Side(MANIFEST.camera) };
const channels = MANIFEST.channels;
let state = stateFromHash(location.hash);
let engine, other, screens, painting, loadedPicture = null, still = null, floodlit = {}, shown = {}, readyLevels = [];
let drawing = null, playing = null, recording = null, frames = 0, framesSince = 0;

const lit = () => sides[state.side];
const seenName = () => ORDER[1 - ORDER.indexOf(state.side)];
const seen = () => sides[seenName()];
const clamp = (value, low, high) => Math.min(high, Math.max(low, value));

function say(text, failed = false) {
  $("status").textContent = text;
  $("status").classList.toggle("failed", failed);
}

// ---- data

async function embedded(prefix, index) {
  for (;;) {
    const element = $(prefix + index);
    // its text is complete once another element follows
    if (element && (document.readyState !== "loading" || element.nextElementSibling)) {
      const text = element.textContent;
      element.remove();
      return text;
    }
    if (document.readyState !== "loading") throw new Error(`the page ends before array ${index}`);
    await new Promise((resolve) => setTimeout(resolve, 10));
  }
}

function blobs(prefix) {
  return (index) => embedded(prefix, index);
}

function kernel() {
  const bytes = Uint8Array.from(atob(KERNEL), (c) => c.charCodeAt(0));
  const wanted = new URLSearchParams(location.search).get("kernel") !== "javascript";
  return wanted && typeof WebAssembly === "object" && WebAssembly.validate(bytes) ? bytes : null;
}

// ---- light

function lightNow() {
  const side = lit(), x = state.x * side.width, y = state.y * side.height;
  const radius = state.size / 100 * Math.min(side.width, side.height);
  let image, colour = linearColour(state.colour, channels);
  if (state.tool === "bar") image = bar(side, x, y, radius, state.soft, state.angle);
  else if (state.tool === "flood") image = new Float32Array(side.perView).fill(1);
  else if (state.tool === "pixel") image = pixel(side, x, y);
  else if (state.tool === "brush" || (state.tool === "picture" && loadedPicture)) {
    image = state.tool === "brush" ? painting.image : loadedPicture;
    colour = Array(channels).fill(1);
    return { light: side.inViews(image, state.litView, channels).slice(), colour };
  } else image = spot(side, x, y, radius, state.soft);
  return { light: side.inViews(image, state.litView), colour };
}

const levelNow = () => {
  const wanted = state.level < 0 ? Infinity : state.level;
  return readyLevels.filter((level) => level <= wanted).at(-1) ?? readyLevels[0];
};

function request(light, colour, dual) {
  const off = state.off.split(",");
  const parts = MANIFEST.parts.map((name) => !off.includes(name));
  return { light, colour, dual, level: levelNow(), parts };
}

// ---- pictures

function whiteOf(image) {
  let top = 0;
  for (const value of image) if (value > top) top = value;
  return top || 1;
}

// White level for the light of a single pixel, which is dim except at the pixel itself: all values
// except one in a thousand, and at least a few, are below it.
function whiteOfMost(image) {
  const sorted = Float32Array.from(image).sort(), n = sorted.length;
  return sorted[n - 1 - Math.min(n - 1, Math.max(4 * channels, n / 1000 | 0))] || whiteOf(image);
}

function exposedWhite() {
  if (state.tool !== "pixel") return MANIFEST.white / 2 ** state.exposure;
  return whiteOfMost(shown.picture) / 2 ** (state.exposure - INITIAL.exposure);
}

// Compute the light and its pictures for the present state.
async function pictured() {
  const { light, colour } = lightNow(), dual = state.side === "camera", hash = stateToHash(state);
  const wanted = [engine.picture(request(light, colour, dual))];
  if (other && (state.wipe || state.difference)) {
    const { levels, parts } = other.about;
    const all = { light, colour, dual, level: levels.at(-1), parts: parts.map(() => true) };
    wanted.push(other.picture(all));
  }
  const [picture, compared] = await Promise.all(wanted);
  const beside = compared || (MANIFEST.still && !dual ? still : null);
  return { light, colour, picture, compared: beside, hash };
}

function show(found) {
  if (!found.picture || found.picture.length !== channels * seen().rays) return;
  shown = found;
  if (state.auto) state.exposure = Math.log2(MANIFEST.white / whiteOf(found.picture));
  paint();
  document.body.dataset.shown = state.auto ? stateToHash(state) : found.hash;
  count();
}

function paint() {
  const white = exposedWhite(), { picture, compared } = shown;
  const usable = compared && compared.length === picture.length ? compared : null;
  screens.seen.show(picture, { view: state.seenView, white, tone: state.tone, other: usable,
    wipe: state.wipe / 100, limit: state.difference ? state.limit / 100 : 0 });
  if (state.tool === "pixel" && state.px >= 0) screens.seen.mark(state.px, state.py);
  paintLight();
  const compares = usable && (state.wipe || state.difference) && !playing && drawing === null;
  $("compared").textContent = compares ? differenceText(picture, usable) : "";
  if (state.auto) showControls();
}

function differenceText(picture, compared) {
  const { rms, largest } = differenceOf(picture, compared, MANIFEST.white);
  return `Differs by ${(100 * rms).toPrecision(2)} % (relative RMS); at most ` +
    `${(100 * largest).toPrecision(2)} % of white.`;
}

// Draw the light or, for a picked pixel, the places from which it receives light.
async function paintLight() {
  const view = state.litView < 0 ? 0 : state.litView;
  if (state.tool === "pixel" && state.px >= 0) {
    const side = seen(), image = pixel(side, state.px * side.width, state.py * side.height);
    const light = side.inViews(image, state.seenView);
    const dual = state.side === "projector";
    const row = await engine.picture(request(light, Array(channels).fill(1), dual), "row");
    if (row && row.length === channels * lit().rays && state.tool === "pixel") {
      screens.light.show(row, { view, white: whiteOfMost(row), tone: "soft" });
    }
    return;
  }
  screens.light.showLight(shown.light, shown.colour,
    { view, floodlit: floodlit[state.side], white: MANIFEST.white });
}

async function findFloodlit() {
  for (const name of ORDER) {
    const dual = name === "projector"; // picture of one side under light from the other
    const light = new Float32Array(sides[ORDER[1 - ORDER.indexOf(name)]].rays).fill(1);
    const all = { ...request(light, Array(channels).fill(1), dual),
      parts: MANIFEST.parts.map(() => true) };
    floodlit[name] = await engine.picture(all, "floodlit") || floodlit[name];
  }
}

function count() {
  frames += 1;
  const now = performance.now();
  if (now - framesSince > 1000) {
    document.body.dataset.fps = (1000 * frames / (now - framesSince)).toFixed(1);
    frames = 0;
    framesSince = now;
  }
}

// At most one picture is computed while another is shown; changes meanwhile cause one more.
let requested = false, running = false;
async function update(keep = true) {
  if (keep && !playing) rememberSoon();
  requested = true;
  if (running || !readyLevels.length) return;
  running = true;
  try {
    requested = false;
    for (let next = pictured(); next;) {
      const picture = await next;
      next = requested ? pictured() : null;
      requested = false;
      show(picture);
    }
  } finally {
    running = false;
  }
  if (requested) update(keep);
}

// ---- start

function makeScreens() {
  bound();
  screens = {
    light: new Screen($("light"), lit(), channels),
    seen: new Screen($("seen"), seen(), channels),
  };
  painting = new Painting(lit(), channels);
  $("light-name").textContent = state.side === "projector" ? "Projector's side" : "Camera's side";
  $("seen-name").textContent = state.side === "projector" ? "Camera's view" : "Projector's view";
}

async function begin() {
  makeScreens();
  bindControls();
  bindScreens();
  showControls();
  const simd = kernel(), cores = clamp((navigator.hardwareConcurrency || 2), 1, 6);
  engine = new Engine(MANIFEST, blobs("l"), cores, simd);
  $("runs").textContent = `${simd ? "WebAssembly with SIMD" : "plain JavaScript"}, ` +
    `${engine.workers.length} workers`;
  document.body.dataset.kernel = simd ? "wasm" : "javascript";
  engine.onfail = (message) => say(`The page can't go on: ${message}`, true);
  engine.onlevel = (ready) => arrived(ready);
  if (MANIFEST.other) {
    other = new Engine(MANIFEST.other, blobs("c"), Math.max(1, cores >> 1), simd);
    other.onfail = engine.onfail;
  }
  $("comparing").hidden = !MANIFEST.other && !MANIFEST.still;
  await engine.load();
  if (other) await other.load();
  if (MANIFEST.still) await loadStill(blobs("c"));
}

async function loadStill(blob) {
  const data = Uint8Array.from(atob(await blob(0)), (c) => c.charCodeAt(0));
  const stream = new Blob([data]).stream().pipeThrough(new DecompressionStream("gzip"));
  const planes = new Uint8Array(await new Response(stream).arrayBuffer()), n = planes.length / 4;
  const bytes = new Uint8Array(planes.length);
  for (let k = 0; k < planes.length; k++) bytes[4 * (k % n) + Math.floor(k / n)] = planes[k];
  still = new Float32Array(bytes.buffer);
  update(false);
}

let arriving = Promise.resolve();
function arrived(ready) {
  if (ready.length === readyLevels.length) return;
  const first = !readyLevels.length, all = ready.length === MANIFEST.levels.length;
  readyLevels = ready;
  say(all ? "Drag the light." : `Level ${ready.at(-1)} of ${MANIFEST.levels.at(-1)} is here; finer ones follow.`);
  if (first) document.body.dataset.first = performance.now().toFixed(0);
  if (!first && !all) { update(false); return; }
  arriving = arriving.then(async () => {
    await findFloodlit();
    await update(false);
    if (all) document.body.dataset.ready = performance.now().toFixed(0);
  });
}

begin().catch((error) => say(`The page can't go on: ${error.message || error}`, true));
