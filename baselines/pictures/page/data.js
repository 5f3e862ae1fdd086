// Arrays and colours as the page carries them: see pack.py.

const KINDS = { u1: Uint8Array, i2: Int16Array, u4: Uint32Array };

/** The array that was packed. Second differences over the first axis are summed up again; they wrap round. */
async function unpack(packed) {
  const bytes = Uint8Array.from(atob(packed.data), (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  const array = new KINDS[packed.kind](await new Response(stream).arrayBuffer());
  const row = packed.shape.slice(1).reduce((product, n) => product * n, 1);
  for (let order = 0; order < packed.order; order++) {
    for (let i = row; i < array.length; i++) array[i] += array[i - row];
  }
  return array;
}

/** Where time stands among ascending moments: the one before, and the part of the way to the next. */
function between(moments, time) {
  let low = 0;
  let high = moments.length - 1;
  if (high <= 0) return { before: 0, after: 0, part: 0 };
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (moments[middle] <= time) low = middle;
    else high = middle;
  }
  const way = moments[high] - moments[low];
  const part = way > 0 ? Math.min(1, Math.max(0, (time - moments[low]) / way)) : 0;
  return { before: low, after: high, part };
}

/** A number of a curve at a time: null where it is not defined, Infinity where it has no bound. */
function valueAt(moments, values, time) {
  const { before, after, part } = between(moments, time);
  const [a, b] = [values[before], values[after]].map((v) => (v === "inf" ? Infinity : v));
  if (part === 0 || b === null) return a;
  if (part === 1 || a === null) return part === 1 ? b : null;
  return a === Infinity || b === Infinity ? Infinity : a + (b - a) * part;
}

/** Colours of strain from 0 to the top of the scale, as CSS has them (bytes) and as light (linear, 0 to 1). */
function strainColours(hex) {
  const bytes = Uint8Array.from(hex.match(/../g), (two) => parseInt(two, 16));
  const colour = new THREE.Color();
  const light = new Float32Array(bytes.length);
  for (let i = 0; i < bytes.length; i += 3) {
    colour.setRGB(bytes[i] / 255, bytes[i + 1] / 255, bytes[i + 2] / 255, THREE.SRGBColorSpace).toArray(light, i);
  }
  return { bytes, light };
}
