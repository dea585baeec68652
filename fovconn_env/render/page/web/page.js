"use strict";
// Playback: one time for the 3-D view, the plots, the slider and the clock.

const element = (id) => document.getElementById(id);

function complain(message) {
  element("problem").hidden = false;
  element("problem").textContent = message;
}

class Player {
  constructor(flight) {
    this.flight = flight;
    this.time = 0;
    this.playing = false;
    const seek = (time) => this.seek(time);
    element("time").max = flight.end;
    this._listRobots();
    try {
      this.view = new View(element("view"), flight);
      this.view.changed = () => this.request();
    } catch (problem) {
      complain(`No 3-D view: this browser offers no WebGL (${problem.message}). The plots work.`);
    }
    this.lambda2 = lambda2Plot(element("lambda2"), flight, seek);
    this.yaw = yawPlot(element("yaw"), flight, flight.observer, seek);
    this._listen(seek);
    this.resize();
    this.view?.show(0);
    this.view?.look("team");
    this.seek(Number(new URLSearchParams(location.hash.slice(1)).get("t")) || 0);
  }

  _listRobots() {
    const { n, led, fails, observer } = this.flight;
    for (let i = 0; i < n; i++) {
      const item = document.createElement("li"), dot = document.createElement("span");
      dot.className = "dot";
      dot.style.setProperty("--color", `var(--robot-${i})`);
      item.append(dot, String(i + 1));
      element("robots").append(item);
      element("linked").append(new Option(`of ${i + 1}`, i));
      element("observer").append(new Option(`robot ${i + 1}`, i, false, i === observer));
    }
    document.querySelectorAll(".led").forEach((item) => { item.hidden = !led; });
    document.querySelectorAll(".fails").forEach((item) => { item.hidden = !fails; });
  }

  _listen(seek) {
    element("play").onclick = () => this.toggle();
    element("time").oninput = () => seek(element("time").valueAsNumber);
    element("look").onchange = () => { this.view?.look(element("look").value); this.request(); };
    element("observer").onchange = () => {
      element("yaw").replaceChildren();
      this.yaw = yawPlot(element("yaw"), this.flight, Number(element("observer").value), seek);
      this.request();
    };
    element("linked").onchange = () => {
      if (this.view) this.view.linked = element("linked").value === "" ? null : Number(element("linked").value);
      this.request();
    };
    for (const name of ["cones", "trails"]) element(name).onchange = () => this.request();
    window.addEventListener("keydown", (event) => this.press(event));
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => {
      [this.view, this.lambda2, this.yaw].forEach((part) => part?.repaint());
      this.request();
    });
    new ResizeObserver(() => this.resize()).observe(document.querySelector("main"));
  }

  press(event) {
    const step = event.shiftKey ? this.flight.interval : 1, speed = element("speed");
    const keys = {
      Space: () => this.toggle(),
      ArrowLeft: () => this.seek(this.time - step),
      ArrowRight: () => this.seek(this.time + step),
      ArrowUp: () => { speed.selectedIndex = Math.min(speed.selectedIndex + 1, speed.length - 1); },
      ArrowDown: () => { speed.selectedIndex = Math.max(speed.selectedIndex - 1, 0); },
      Home: () => this.seek(0),
      End: () => this.seek(this.flight.end),
    };
    const named = event.key === " " ? "Space" : event.key; // an input method hides it; the code is the key's place
    const act = keys[event.code] ?? keys[named], space = act === keys.Space;
    const busy = event.target.tagName === "SELECT" || (space && event.target.type === "checkbox");
    if (!act || busy || event.ctrlKey || event.altKey || event.metaKey) return;
    event.preventDefault();
    act();
  }

  toggle() {
    if (!this.playing && this.time >= this.flight.end) this.time = 0;
    this.playing = !this.playing;
    this.clock = null;
    element("play").textContent = this.playing ? "⏸" : "▶";
    element("play").setAttribute("aria-label", this.playing ? "pause" : "play");
    this.request();
  }

  seek(time) {
    this.time = Math.min(Math.max(time, 0), this.flight.end);
    this.request();
  }

  resize() {
    [this.view, this.lambda2, this.yaw].forEach((part) => part?.resize());
    this.request();
  }

  /** Draw with the screen's next picture. */
  request() {
    this.frame ??= requestAnimationFrame((clock) => this.draw(clock));
  }

  draw(clock) {
    this.frame = null;
    if (this.playing) {
      const speed = Number(element("speed").value);
      this.time = Math.min(this.time + (speed * (clock - (this.clock ?? clock))) / 1000, this.flight.end);
      this.clock = clock;
    }
    this._write();
    for (const plot of [this.lambda2, this.yaw]) plot.show(this.time);
    if (this.view) {
      this.view.show(this.time);
      for (const robot of this.view.robots) {
        robot.cone.visible = robot.alive && element("cones").checked;
        robot.trail.visible = element("trails").checked;
      }
      this.view.draw();
    }
    if (this.playing && this.time >= this.flight.end) this.toggle();
    if (this.playing) this.request();
    document.documentElement.dataset.ready ??= Math.round(performance.now()); // ms until the first picture
  }

  _write() {
    const { flight, time } = this, now = locate(flight, time), links = linksAt(flight, now);
    const mutual = links.filter(([, , , own, other]) => own && other).length;
    const leader = flight.led ? leaderAt(flight, now) : null;
    [...element("robots").children].forEach((item, i) => {
      item.classList.toggle("leads", i === leader);
      item.classList.toggle("down", !aliveAt(flight, i, now));
    });
    element("time").value = time;
    element("elapsed").textContent = `${time.toFixed(1)} / ${flight.end.toFixed(1)} s`;
    element("clock").textContent =
      `${time.toFixed(1)} s · ${links.length} links, ${mutual} mutual${time >= flight.end ? ` · ${flight.ending}` : ""}`;
    element("now").textContent = `true ${between(flight.lambda2, 1, 0, now).toFixed(3)}, min ${flight.bound}`;
  }
}

let player; // for the console
window.addEventListener("error", (event) => complain(event.message));
loadFlight().then((flight) => { player = new Player(flight); }).catch((problem) => {
  complain(`The flight cannot be shown: ${problem.message}. A browser from 2023 or later is needed.`);
  throw problem;
});
