"use strict";
// Curves over time with a playhead; a click or a drag goes to that time.

const { uPlot } = libraries;
const column = (array, width, at) => Array.from({ length: array.length / width }, (_, k) => array[k * width + at]);
const stroke = (name, width, dash) => ({ stroke: () => color(name), width, dash, points: { show: false } });
const finite = (x) => (Number.isFinite(x) ? x : null);

class Plot {
  constructor(holder, flight, series, scale, data, seek) {
    this.holder = holder;
    const axis = { stroke: () => color("text"), grid: { stroke: () => color("grid"), width: 1 }, ticks: { show: false } };
    const options = {
      ...this._size(), series: [{}, ...series], legend: { show: false }, padding: [10, 22, 0, 0],
      scales: { x: { time: false, range: [0, flight.end] }, y: scale },
      axes: [{ ...axis, size: 26, values: (_, ticks) => ticks.map((t) => `${t} s`) }, { ...axis, size: 46, splits: scale.splits }],
      cursor: { drag: { x: false, y: false, setScale: false }, y: false, points: { show: false } },
    };
    this.chart = new uPlot(options, [Array.from(flight.time), ...data], holder);
    this.playhead = document.createElement("div");
    this.playhead.className = "playhead";
    this.chart.over.append(this.playhead);
    const go = (event) => seek(this.chart.posToVal(event.clientX - this.chart.over.getBoundingClientRect().left, "x"));
    this.chart.over.addEventListener("pointerdown", go);
    this.chart.over.addEventListener("pointermove", (event) => { if (event.buttons) go(event); });
  }

  _size() {
    return { width: this.holder.clientWidth, height: this.holder.clientHeight };
  }

  resize() {
    this.chart.setSize(this._size());
  }

  repaint() {
    this.chart.redraw(false);
  }

  show(time) {
    this.playhead.style.transform = `translateX(${this.chart.valToPos(time, "x")}px)`;
  }
}

/** True lambda2, every robot's estimate and the bound, on an axis of square roots: small values can be told apart. */
function lambda2Plot(holder, flight, seek) {
  const { n, bound } = flight, estimates = Array.from({ length: n }, (_, i) => column(flight.lambda2_hat, n, i).map(finite));
  const truth = Array.from(flight.lambda2);
  const top = 1.08 * Math.max(...truth, 4 * bound, Math.min(2 * Math.max(...truth), Math.max(...estimates.flat().filter((x) => x !== null))));
  const step = [0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10].find((tick) => top / tick <= 5) ?? 20;
  const ticks = [0, step / 5, ...Array.from({ length: Math.floor(top / step) }, (_, k) => (k + 1) * step)];
  const scale = {
    distr: 100, fwd: (x) => Math.sqrt(Math.max(x, 0)), bwd: (x) => x * x, range: [0, top], splits: () => ticks.map((t) => Number(t.toPrecision(6))),
  };
  const series = [stroke("text", 1.2, [6, 4]), stroke("truth", 4), ...estimates.map((_, i) => stroke(`robot-${i}`, 1.1))];
  return new Plot(holder, flight, series, scale, [truth.map(() => bound), truth, ...estimates], seek);
}

/** One robot's yaw errors, degrees: valid estimates strong in the colour of whom they are about, others faint. */
function yawPlot(holder, flight, i, seek) {
  const { n } = flight, others = Array.from({ length: n }, (_, j) => j).filter((j) => j !== i);
  const data = [], series = [];
  let most = 10;
  for (const valid of [false, true]) {
    for (const j of others) {
      const at = i * n + j, error = column(flight.yaw_error, n * n, at).map((x) => (x * 0.18) / Math.PI);
      const curve = error.map((x, k) => {
        const wraps = k > 0 && Math.abs(x - error[k - 1]) > 180;
        return wraps || (valid && !flight.yaw_valid[k * n * n + at]) ? null : x;
      });
      if (valid) most = Math.max(most, ...curve.map((x) => Math.abs(x ?? 0)));
      data.push(curve);
      series.push(valid ? stroke(`robot-${j}`, 1.8) : stroke("faint", 1, [3, 3]));
    }
  }
  const end = [10, 20, 45, 90, 180].find((limit) => most <= limit) ?? 180;
  const splits = () => [-end, -end / 2, 0, end / 2, end];
  return new Plot(holder, flight, series, { range: [-1.08 * end, 1.08 * end], splits }, data, seek);
}
