// Sliders, buttons, mouse, touch and keys.
const SLIDERS = ["size", "soft", "angle", "exposure", "wipe", "limit", "litView", "seenView"];
const UNITS = {
  size: (v) => `${v} %`, soft: (v) => v.toFixed(2), angle: (v) => `${v}°`,
  exposure: (v) => `${v > 0 ? "+" : ""}${v.toFixed(2)}`, wipe: (v) => `${v} %`,
  limit: (v) => `±${v} %`, litView: (v) => (v < 0 ? "all" : `${v + 1}`), seenView: (v) => `${v + 1}`,
};

// Factors by which a saved picture is enlarged; by default the first with this many pixels.
const SCALES = [1, 2, 4, 8, 16, 32], LARGE_ENOUGH = 1000, LARGEST_SIDE = 8192;

let remembering = 0;
function rememberSoon() {
  clearTimeout(remembering);
  remembering = setTimeout(() => history.replaceState(null, "", `#${stateToHash(state)}`), 300);
}

// Show the state in the controls.
function showControls() {
  $("litView").max = lit().views - 1;
  $("seenView").max = seen().views - 1;
  for (const id of SLIDERS) {
    $(id).value = state[id];
    const text = UNITS[id](Number(state[id]));
    document.querySelector(`output[for=${id}]`).textContent = text;
    $(id).setAttribute("aria-valuetext", text);
  }
  for (const id of ["side", "colour", "tone"]) $(id).value = state[id];
  $("difference").checked = state.difference;
  $("auto").setAttribute("aria-pressed", String(state.auto));
  const { levels } = MANIFEST, index = state.level < 0 ? levels.length - 1
    : Math.max(0, levels.filter((level) => level <= state.level).length - 1);
  $("level").max = levels.length - 1;
  $("level").value = index;
  document.querySelector("output[for=level]").textContent = levels[index];
  $("level").setAttribute("aria-valuetext", `level ${levels[index]}`);
  $("levels").hidden = levels.length < 2;
  for (const button of $("tools").children) {
    button.setAttribute("aria-pressed", String(button.dataset.tool === state.tool));
  }
  for (const element of document.querySelectorAll("[data-for]")) {
    element.hidden = !element.dataset.for.split(" ").includes(state.tool);
  }
  $("litView").closest(".row").hidden = lit().views < 2;
  $("seenView").closest(".row").hidden = seen().views < 2;
  const off = state.off.split(",");
  for (const box of $("parts").querySelectorAll("input")) box.checked = !off.includes(box.value);
  $("light-note").textContent = state.tool === "pixel"
    ? (state.px < 0 ? "click a pixel to light it" : "where the picked pixel's light comes from")
    : { flood: "all of it", picture: loadedPicture ? "the picture" : "choose a picture" }[state.tool]
      || "drag here";
  $("seen-note").textContent = state.tool === "pixel" ? "click: where does its light come from?"
    : sharesPlaces() ? "or drag here" : "";
  showScales();
  $("path").textContent = state.path ? `${(state.path.length / 80).toFixed(1)} s recorded.`
    : "Nothing recorded: Play sweeps over the scene.";
}

// Sizes at which the picture can be saved.
function showScales() {
  const { width, height } = seen(), longer = Math.max(width, height);
  const scales = SCALES.filter((scale) => scale === 1 || scale * longer <= LARGEST_SIDE);
  const wanted = Number($("scale").value) || scales.find((scale) => scale * longer >= LARGE_ENOUGH);
  $("scale").replaceChildren(...scales.map((scale) =>
    new Option(`${scale * width} x ${scale * height} pixels`, scale)));
  $("scale").value = scales.includes(wanted) ? wanted : scales.at(-1);
}

// Number of views.
function bound() {
  state.seenView = clamp(Math.round(state.seenView), 0, seen().views - 1);
  state.litView = clamp(Math.round(state.litView), -1, lit().views - 1);
}

// Test whether a place in the picture also is a place of the light.
const sharesPlaces = () => MANIFEST.coaxial && (lit().views < 2 || state.litView === state.seenView);

function set(changes) {
  Object.assign(state, changes);
  bound();
  showControls();
  update();
}

function bindControls() {
  for (const id of SLIDERS) $(id).addEventListener("input", () => set({ [id]: Number($(id).value) }));
  $("exposure").addEventListener("input", () => set({ auto: false }));
  $("level").addEventListener("input", () => {
    const index = Number($("level").value), { levels } = MANIFEST;
    set({ level: index === levels.length - 1 ? -1 : levels[index] });
  });
  for (const id of ["colour", "tone"]) $(id).addEventListener("input", () => set({ [id]: $(id).value }));
  $("side").addEventListener("change", () => switchSide($("side").value));
  $("difference").addEventListener("change", () => set({ difference: $("difference").checked }));
  $("tools").addEventListener("click", ({ target }) => {
    if (target.dataset.tool) set({ tool: target.dataset.tool, px: -1, py: -1 });
  });
  $("clear").addEventListener("click", () => { painting.clear(); update(); });
  $("fit").addEventListener("click", () => {
    if (shown.picture) set({ exposure: clamp(Math.log2(MANIFEST.white / whiteOf(shown.picture)), -6, 12) });
  });
  $("auto").addEventListener("click", () => set({ auto: !state.auto }));
  $("file").addEventListener("change", readPicture);
  $("record").addEventListener("click", () => (recording ? stopRecording() : startRecording()));
  $("play").addEventListener("click", () => (playing ? stopPlaying() : startPlaying()));
  $("save").addEventListener("click", savePicture);
  $("link").addEventListener("click", copyLink);
  $("reset").addEventListener("click", () => { const { side } = state; state.side = "projector";
    if (side !== "projector") makeScreens(); painting.clear(); $("kept").textContent = "";
    set({ ...INITIAL }); });
  addEventListener("hashchange", () => { state = stateFromHash(location.hash); makeScreens(); set({}); });
  if (MANIFEST.parts.length > 1) {
    for (const name of MANIFEST.parts) {
      const label = document.createElement("label"), box = document.createElement("input");
      box.type = "checkbox";
      box.value = name;
      box.addEventListener("change", () => set({ off: [...$("parts").querySelectorAll("input")]
        .filter((each) => !each.checked).map((each) => each.value).join(",") }));
      label.append(box, ` ${name}`);
      $("parts").append(label);
    }
  } else $("parts").hidden = true;
}

async function switchSide(side) {
  state.side = side;
  loadedPicture = null;
  makeScreens();
  set({ px: -1, py: -1, tool: state.tool === "picture" ? "spot" : state.tool });
}

async function readPicture() {
  const [file] = $("file").files;
  if (!file) return;
  try {
    loadedPicture = await pictureLight(file, lit(), channels);
    set({});
  } catch {
    say(`${file.name} can't be read as a picture; choose a PNG, JPEG or WebP.`, true);
  }
}

// ---- mouse, touch and keys

function placeOf(event, canvas) {
  const box = canvas.getBoundingClientRect(), ratio = canvas.width / canvas.height;
  const width = Math.min(box.width, box.height * ratio), height = width / ratio;
  return {
    x: clamp((event.clientX - box.left - (box.width - width) / 2) / width, 0, 1),
    y: clamp((event.clientY - box.top - (box.height - height) / 2) / height, 0, 1),
  };
}

function moveTo({ x, y }, which) {
  if (which === "seen" && state.tool === "pixel") set({ px: x, py: y });
  else if (which === "light" || sharesPlaces()) {
    state.x = x;
    state.y = y;
    if (state.tool === "pixel") state.px = state.py = -1;
    if (state.tool === "brush") paintStroke();
    set({});
  }
}

function paintStroke() {
  const side = lit(), radius = state.size / 100 * Math.min(side.width, side.height);
  painting.stroke(state.x * side.width, state.y * side.height, radius, state.soft,
    linearColour(state.colour, channels));
}

function bindScreens() {
  for (const which of ["light", "seen"]) {
    const canvas = $(which);
    canvas.addEventListener("pointerdown", (event) => {
      stopPlaying();
      drawing = event.pointerId;
      canvas.setPointerCapture(event.pointerId);
      moveTo(placeOf(event, canvas), which);
    });
    canvas.addEventListener("pointermove", (event) => {
      if (drawing === event.pointerId) moveTo(placeOf(event, canvas), which);
    });
    const end = () => { drawing = null; update(false); };
    canvas.addEventListener("pointerup", end);
    canvas.addEventListener("pointercancel", end);
    canvas.addEventListener("keydown", (event) => byKey(event, which));
  }
}

const STEPS_OF_KEYS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
function byKey(event, which) {
  const step = STEPS_OF_KEYS[event.key];
  if (step) {
    const side = which === "seen" ? seen() : lit(), times = event.shiftKey ? 10 : 1;
    const picks = which === "seen" && state.tool === "pixel";
    const [x, y] = picks ? [state.px < 0 ? 0.5 : state.px, state.py < 0 ? 0.5 : state.py] : [state.x, state.y];
    stopPlaying();
    moveTo({ x: clamp(x + times * step[0] / side.width, 0, 1),
      y: clamp(y + times * step[1] / side.height, 0, 1) }, which);
  } else if (event.key === "+" || event.key === "=") set({ size: clamp(state.size + 1, 0.5, 60) });
  else if (event.key === "-") set({ size: clamp(state.size - 1, 0.5, 60) });
  else return;
  event.preventDefault();
}

// ---- paths, pictures and links

function startRecording() {
  stopPlaying();
  const places = [];
  recording = { timer: setInterval(() => {
    places.push([state.x, state.y]);
    $("path").textContent = `Recording: ${(places.length / 20).toFixed(1)} s.`;
    if (places.length >= 600) stopRecording();
  }, 50), places };
  $("record").setAttribute("aria-pressed", "true");
}

function stopRecording() {
  clearInterval(recording.timer);
  const path = new Path();
  path.places = recording.places;
  recording = null;
  $("record").setAttribute("aria-pressed", "false");
  set({ path: path.text() });
}

function startPlaying() {
  if (recording) stopRecording();
  const path = new Path(state.path), since = performance.now();
  if (!["spot", "bar", "pixel"].includes(state.tool)) set({ tool: "spot" });
  const move = () => {
    if (!playing) return;
    [state.x, state.y] = path.at((performance.now() - since) / 1000);
    update(false);
    playing.frame = requestAnimationFrame(move);
  };
  playing = { frame: 0 };
  playing.frame = requestAnimationFrame(move);
  $("play").setAttribute("aria-pressed", "true");
}

function stopPlaying() {
  if (!playing) return;
  cancelAnimationFrame(playing.frame);
  playing = null;
  $("play").setAttribute("aria-pressed", "false");
}

// A canvas whose every pixel is a square of `scale` x `scale` pixels.
function enlarged(canvas, scale) {
  const large = document.createElement("canvas");
  large.width = scale * canvas.width;
  large.height = scale * canvas.height;
  const context = large.getContext("2d");
  context.imageSmoothingEnabled = false;
  context.drawImage(canvas, 0, 0, large.width, large.height);
  return large;
}

function savePicture() {
  const picture = enlarged($("seen"), Number($("scale").value));
  picture.toBlob((blob) => {
    const link = document.createElement("a");
    link.href = URL.createObjectURL(blob);
    link.download = `${MANIFEST.name}.png`;
    link.click();
    setTimeout(() => URL.revokeObjectURL(link.href), 1000);
    $("kept").textContent = `${link.download} saved, ${picture.width} x ${picture.height} pixels.`;
  });
}

async function copyLink() {
  history.replaceState(null, "", `#${stateToHash(state)}`);
  try {
    await navigator.clipboard.writeText(location.href);
    $("kept").textContent = "The link is in the clipboard.";
  } catch {
    $("kept").textContent = "The address of this page is the link; the clipboard can't be written.";
  }
}
