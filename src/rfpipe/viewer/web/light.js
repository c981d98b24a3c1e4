// Light patterns: weights of the rays of one side, in planes of one channel or of all.
const linear = (v) => (v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);

function linearColour(hex, channels) {
  const rgb = [1, 3, 5].map((at) => linear(parseInt(hex.slice(at, at + 2), 16) / 255));
  return channels === 3 ? rgb : Array(channels).fill((rgb[0] + rgb[1] + rgb[2]) / 3);
}

// One side's rays as views of height x width.
class Side {
  constructor(shape) {
    [this.height, this.width] = shape.slice(-2);
    this.views = shape.slice(0, -2).reduce((product, size) => product * size, 1);
    this.perView = this.height * this.width;
    this.rays = this.views * this.perView;
  }

  // The same weights in one view, or in all of them (-1).
  inViews(image, view, planes = 1) {
    if (this.views === 1) return image;
    const light = new Float32Array(planes * this.rays);
    for (let plane = 0; plane < planes; plane++) {
      const own = image.subarray(plane * this.perView, (plane + 1) * this.perView);
      for (let v = 0; v < this.views; v++) {
        if (view < 0 || v === view) light.set(own, plane * this.rays + v * this.perView);
      }
    }
    return light;
  }
}

// 1 inside, 0 outside, between them over a rim whose width is `soft` times the radius.
function falloff(distance, radius, soft) {
  const rim = Math.max(soft * radius, 1);
  const t = Math.min(1, Math.max(0, (radius + rim / 2 - distance) / rim));
  return t * t * (3 - 2 * t);
}

// A spot of that radius in pixels about a place in pixels.
function spot(side, x, y, radius, soft, image = new Float32Array(side.perView)) {
  const reach = radius * (1 + soft / 2) + 1;
  const y0 = Math.max(0, Math.floor(y - reach)), y1 = Math.min(side.height, y + reach + 1);
  const x0 = Math.max(0, Math.floor(x - reach)), x1 = Math.min(side.width, x + reach + 1);
  for (let row = y0; row < y1; row++) {
    for (let column = x0; column < x1; column++) {
      const weight = falloff(Math.hypot(column + 0.5 - x, row + 0.5 - y), radius, soft);
      const at = row * side.width + column;
      image[at] = Math.max(image[at], weight);
    }
  }
  return image;
}

// A bar through a place, at an angle to the vertical.
function bar(side, x, y, radius, soft, degrees) {
  const image = new Float32Array(side.perView);
  const c = Math.cos(degrees * Math.PI / 180), s = Math.sin(degrees * Math.PI / 180);
  for (let row = 0, at = 0; row < side.height; row++) {
    for (let column = 0; column < side.width; column++, at++) {
      const distance = Math.abs((column + 0.5 - x) * c + (row + 0.5 - y) * s);
      image[at] = falloff(distance, radius, soft);
    }
  }
  return image;
}

function pixel(side, x, y) {
  const image = new Float32Array(side.perView);
  const row = Math.min(side.height - 1, Math.max(0, Math.floor(y)));
  const column = Math.min(side.width - 1, Math.max(0, Math.floor(x)));
  image[row * side.width + column] = 1;
  return image;
}

// Painted strokes, in planes of all channels.
class Painting {
  constructor(side, channels) {
    this.side = side;
    this.channels = channels;
    this.image = new Float32Array(channels * side.perView);
  }

  stroke(x, y, radius, soft, colour) {
    const weights = spot(this.side, x, y, radius, soft), { perView } = this.side;
    for (let channel = 0; channel < this.channels; channel++) {
      for (let i = 0, at = channel * perView; i < perView; i++, at++) {
        if (weights[i]) this.image[at] += weights[i] * (colour[channel] - this.image[at]);
      }
    }
  }

  clear() { this.image.fill(0); }
}

// A picture file as light: fitted to the side, its sRGB values made linear.
async function pictureLight(file, side, channels) {
  const bitmap = await createImageBitmap(file);
  const canvas = new OffscreenCanvas(side.width, side.height), context = canvas.getContext("2d");
  const scale = Math.max(side.width / bitmap.width, side.height / bitmap.height);
  const width = bitmap.width * scale, height = bitmap.height * scale;
  context.imageSmoothingQuality = "high";
  context.drawImage(bitmap, (side.width - width) / 2, (side.height - height) / 2, width, height);
  const pixels = context.getImageData(0, 0, side.width, side.height).data;
  const table = Float32Array.from({ length: 256 }, (_, v) => linear(v / 255));
  const image = new Float32Array(channels * side.perView);
  for (let i = 0; i < side.perView; i++) {
    const rgb = [0, 1, 2].map((k) => table[pixels[4 * i + k]]);
    if (channels === 3) rgb.forEach((value, k) => { image[k * side.perView + i] = value; });
    else image[i] = (rgb[0] + rgb[1] + rgb[2]) / 3;
  }
  return image;
}
