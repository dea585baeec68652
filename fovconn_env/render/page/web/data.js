"use strict";
// The flight as the page holds it: plain settings, and arrays of numbers as zlib streams in base64.

const TYPES = { f8: Float64Array, f4: Float32Array, i2: Int16Array, u1: Uint8Array };

async function unpack({ type, data }) {
  const bytes = Uint8Array.from(atob(data), (letter) => letter.charCodeAt(0));
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new TYPES[type](await new Response(stream).arrayBuffer());
}

/** Settings of page.py's `_settings`, and its arrays by name, T instants of n robots, the last index runs fastest. */
async function loadFlight() {
  const flight = JSON.parse(document.getElementById("flight").textContent);
  await Promise.all(Object.entries(flight.arrays).map(async ([name, array]) => { flight[name] = await unpack(array); }));
  delete flight.arrays;
  flight.end = flight.time[flight.time.length - 1];
  return flight;
}

/** Where a time (s) stands among the instants: {k, share} between instant k and the next one. */
function locate(flight, time) {
  const last = flight.time.length - 1;
  let low = 0, high = last;
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (flight.time[middle] <= time) low = middle; else high = middle;
  }
  const span = flight.time[high] - flight.time[low];
  return { k: low, share: span > 0 ? Math.min(1, Math.max(0, (time - flight.time[low]) / span)) : 0 };
}

/** A number of column `at` of an array with `width` columns, between two instants. */
function between(array, width, at, { k, share }) {
  const before = array[k * width + at], after = array[Math.min((k + 1) * width + at, array.length - width + at)];
  return before + share * (after - before);
}

/** Links at an instant: [i, j, weight, whether i sees j, whether j sees i], i < j. */
function linksAt(flight, now) {
  const { n } = flight, found = [], nearest = { k: now.k + Math.round(now.share), share: 0 };
  for (let i = 0; i < n; i++) {
    for (let j = i + 1; j < n; j++) {
      const at = i * n + j, weight = between(flight.weights, n * n, at, nearest) / 255;
      const sees = (a, b) => flight.sees[Math.min(nearest.k, flight.time.length - 1) * n * n + a * n + b] > 0;
      if (weight > 0) found.push([i, j, weight, sees(i, j), sees(j, i)]);
    }
  }
  return found;
}

/** The robot that leads between an instant and the next. */
function leaderAt(flight, { k, share }) {
  return flight.leader[Math.min(k + (share > 0 ? 1 : 0), flight.time.length - 1)];
}

/** Whether a robot works, and no fault has it down, from an instant to the next. */
function aliveAt(flight, i, { k, share }) {
  return flight.alive[Math.min(k + (share === 1 ? 1 : 0), flight.time.length - 1) * flight.n + i] > 0;
}

/** A colour of the theme, as page.py wrote it for light and dark. */
function color(name) {
  return getComputedStyle(document.documentElement).getPropertyValue(`--${name}`).trim();
}
