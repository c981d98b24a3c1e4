// State of the page, and its form in a link.
const INITIAL = {
  tool: "spot", side: "projector", x: 0.5, y: 0.5, px: -1, py: -1, size: 8, soft: 0.5, angle: 0,
  colour: "#ffffff", exposure: 2, tone: "soft", auto: false, level: -1, off: "", litView: -1,
  seenView: 0, wipe: 0, difference: false, limit: 5, path: "",
};

function stateToHash(state) {
  const params = new URLSearchParams();
  for (const [name, initial] of Object.entries(INITIAL)) {
    const value = typeof state[name] === "number" ? +state[name].toFixed(4) : state[name];
    if (value !== initial) params.set(name, String(value));
  }
  return params.toString();
}

// Invalid values of a link are ignored.
function stateFromHash(hash) {
  const state = { ...INITIAL }, params = new URLSearchParams(hash.replace(/^#/, ""));
  for (const [name, text] of params) {
    if (!(name in INITIAL)) continue;
    if (typeof INITIAL[name] === "number") {
      if (Number.isFinite(Number(text))) state[name] = Number(text);
    } else if (typeof INITIAL[name] === "boolean") state[name] = text === "true";
    else state[name] = text;
  }
  if (!/^#[0-9a-f]{6}$/i.test(state.colour)) state.colour = INITIAL.colour;
  if (!(state.tone in TONES)) state.tone = INITIAL.tone;
  return state;
}

// A light path: places a twentieth of a second apart, two characters for each coordinate.
class Path {
  constructor(text = "") {
    this.places = (text.match(/.{4}/g) || []).map((four) =>
      [four.slice(0, 2), four.slice(2)].map((two) => parseInt(two, 36) / 1295));
    if (this.places.some((place) => place.some(Number.isNaN))) this.places = [];
  }

  text() {
    return this.places.map((place) => place.map((value) => Math.round(
      1295 * Math.min(1, Math.max(0, value))).toString(36).padStart(2, "0")).join("")).join("");
  }

  // The place after a number of seconds; the path repeats.
  at(seconds) {
    if (this.places.length < 2) {
      return [0.5 + 0.42 * Math.sin(1.1 * seconds), 0.5 + 0.36 * Math.sin(1.7 * seconds)];
    }
    const step = (20 * seconds) % this.places.length, n = Math.floor(step), t = step - n;
    const here = this.places[n], next = this.places[(n + 1) % this.places.length];
    return n + 1 === this.places.length ? here : here.map((v, k) => v + t * (next[k] - v));
  }
}
