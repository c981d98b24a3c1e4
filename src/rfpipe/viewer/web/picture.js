// From radiance to pixels.
const STEPS = 4096;
const encode = (v) => (v <= 0.0031308 ? 12.92 * v : 1.055 * v ** (1 / 2.4) - 0.055);
const TONES = {
  srgb: (v) => encode(Math.min(1, v)),
  soft: (v) => encode(Math.min(1, v * (1 + v / 16) / (1 + v))),
  log: (v) => Math.log1p(1000 * Math.min(1, v)) / Math.log(1001),
};
// Values up to 4 times white, in even steps of their square roots.
const TABLES = Object.fromEntries(Object.entries(TONES).map(([name, tone]) => [name,
  Uint8ClampedArray.from({ length: STEPS }, (_, i) => 255 * tone(4 * (i / (STEPS - 1)) ** 2))]));

function toned(value, table) {
  const root = Math.sqrt(value > 0 ? value * 0.25 : 0);
  return table[root < 1 ? (root * (STEPS - 1) + 0.5) | 0 : STEPS - 1];
}

// Blue below, red above: a difference of -1 to 1 over a dim grey of the picture.
function differenceColour(t, grey, out, at) {
  const strength = Math.min(1, Math.abs(t)), rest = (1 - strength) * grey;
  out[at] = rest + strength * (t > 0 ? 230 : 40);
  out[at + 1] = rest + strength * (t > 0 ? 85 : 120);
  out[at + 2] = rest + strength * (t > 0 ? 45 : 235);
}

// One view of a planar image on a canvas.
class Screen {
  constructor(canvas, side, channels) {
    Object.assign(this, { canvas, side, channels });
    canvas.width = side.width;
    canvas.height = side.height;
    this.context = canvas.getContext("2d");
    this.pixels = this.context.createImageData(side.width, side.height);
    this.pixels.data.fill(255);
  }

  plane(channel, view) {
    return (this.channels === 1 ? 0 : channel) * this.side.rays + view * this.side.perView;
  }

  // `other` is shown at the left of the wipe, a part of the width; `difference` instead of light.
  show(image, { view = 0, white = 1, tone = "srgb", other = null, wipe = 0, limit = 0 }) {
    const { data } = this.pixels, table = TABLES[tone], { width, perView } = this.side;
    const at = [0, 1, 2].map((channel) => this.plane(channel, view)), scale = 1 / white;
    const edge = Math.round(wipe * width);
    for (let i = 0, to = 0; i < perView; i++, to += 4) {
      const from = other && i % width < edge ? other : image;
      if (limit && other) {
        let sum = 0, light = 0;
        for (let k = 0; k < 3; k++) {
          sum += image[at[k] + i] - other[at[k] + i];
          light += other[at[k] + i];
        }
        differenceColour(sum * scale / 3 / limit, 0.5 * toned(light * scale / 3, table), data, to);
      } else {
        for (let k = 0; k < 3; k++) data[to + k] = toned(from[at[k] + i] * scale, table);
      }
    }
    this.context.putImageData(this.pixels, 0, 0);
    if (other && edge > 0 && edge < width) {
      this.context.fillStyle = "#ffffff90";
      this.context.fillRect(edge, 0, Math.max(1, width / 350), this.side.height);
    }
  }

  // A frame about the pixel at a place, in parts of the image.
  mark(x, y) {
    const column = Math.floor(x * this.side.width), row = Math.floor(y * this.side.height);
    const around = Math.max(1, Math.round(this.side.width / 80));
    this.context.strokeStyle = "#ffb000";
    this.context.lineWidth = Math.max(0.5, this.side.width / 300);
    this.context.strokeRect(column - around, row - around, 2 * around + 1, 2 * around + 1);
  }

  // The light over a dim picture of the lit side; `weights` has one plane, or one per channel.
  showLight(weights, colour, { view = 0, floodlit = null, white = 1 }) {
    const { data } = this.pixels, table = TABLES.srgb, { perView, rays } = this.side;
    const planes = weights.length / rays;
    for (let k = 0; k < 3; k++) {
      const at = this.plane(k, view), channel = this.channels === 1 ? 0 : k;
      const from = (planes > 1 ? channel * rays : 0) + view * perView;
      for (let i = 0, to = k; i < perView; i++, to += 4) {
        const seen = floodlit ? Math.min(1, floodlit[at + i] / white) : 0.3;
        const lit = weights[from + i] * colour[channel];
        data[to] = toned(0.12 * seen + lit * (0.15 + 0.85 * seen), table);
      }
    }
    this.context.putImageData(this.pixels, 0, 0);
  }
}

// Relative RMS of a difference, and the largest one relative to white.
function differenceOf(image, other, white) {
  let squares = 0, of = 0, largest = 0;
  for (let i = 0; i < image.length; i++) {
    const d = image[i] - other[i];
    squares += d * d;
    of += other[i] * other[i];
    largest = Math.max(largest, Math.abs(d));
  }
  return { rms: of ? Math.sqrt(squares / of) : 0, largest: largest / white };
}
