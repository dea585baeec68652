"use strict";
// The team in 3-D at any time of the flight. World frame, z up, m.

const TRAIL = 15; // s
const TRAIL_POINTS = 50;
const HALF_WIDTH = 0.42; // m of a drawn robot; never less than LEAST px
const LEAST = 11;

class View {
  constructor(canvas, flight) {
    this.canvas = canvas;
    this.flight = flight;
    this.renderer = new L.WebGLRenderer({ canvas, antialias: true });
    this.scene = new L.Scene();
    this.camera = new L.PerspectiveCamera(40, 1, 0.2, 2000);
    this.camera.up.set(0, 0, 1);
    this.controls = new L.OrbitControls(this.camera, canvas);
    this.controls.maxPolarAngle = 0.495 * Math.PI;
    this.controls.addEventListener("change", () => this.changed());
    this.changed = () => {};
    this.at = Array.from({ length: flight.n }, () => new L.Vector3());
    this.painters = []; // called with a new theme
    this.labels = [];
    this.linked = null; // whose links alone are shown
    this.fine = flight.n > 12 ? 0.6 : 1; // a large team is drawn thinner
    this._light();
    this._ground();
    this._course();
    this._robots();
    this._links();
    this.painters.forEach((paint) => paint());
  }

  _add(...objects) {
    this.scene.add(...objects);
    return objects[0];
  }

  _paint(material, name) {
    this.painters.push(() => material.color.set(color(name)));
    return material;
  }

  /** A word of `pixels` on the screen in letters of `size` of 96; `name` is that of its colour, or a function. */
  _label(name, word, size, pixels) {
    const { sprite, paint } = label(), named = () => (typeof name === "string" ? name : name());
    sprite.repaint = () => paint(word, color(named()), color("panel"), size);
    this.painters.push(sprite.repaint);
    this.labels.push([sprite, pixels]);
    return this._add(sprite);
  }

  _light() {
    const sun = new L.DirectionalLight(0xffffff, 2.0);
    sun.position.set(-2, -4, 6);
    this._add(new L.AmbientLight(0xffffff, 1.6), sun);
    this.painters.push(() => { this.scene.background = new L.Color(color("panel")); });
  }

  _ground() {
    const { low, high, floor, ceiling, grid } = this.flight;
    const first = low.map((x) => Math.floor(x / grid) * grid), last = high.map((x) => Math.ceil(x / grid) * grid);
    for (const z of ceiling === null ? [floor] : [floor, ceiling]) {
      const lines = [];
      for (let x = first[0]; x <= last[0]; x += grid) lines.push([x, first[1], z], [x, last[1], z]);
      for (let y = first[1]; y <= last[1]; y += grid) lines.push([first[0], y, z], [last[0], y, z]);
      this._add(new L.LineSegments(points(lines), this._paint(line(), "grid")));
    }
    const plane = new L.Mesh(new L.PlaneGeometry(last[0] - first[0], last[1] - first[1]), this._paint(flat(), "ground"));
    plane.position.set((first[0] + last[0]) / 2, (first[1] + last[1]) / 2, floor - 0.03);
    this._add(plane);
    for (const piece of this.flight.obstacles) {
      const { block, skin, edge } = prism(piece);
      this._paint(skin, "obstacle");
      this._paint(edge, "faint");
      this._add(block);
    }
  }

  _course() {
    const { course } = this.flight;
    this.goals = []; // numbers of way points
    if (course.length < 2) return;
    const skin = this._paint(new L.LineDashedMaterial({ dashSize: 0.35, gapSize: 0.3 }), "operator");
    this._add(new L.Line(points(course), skin)).computeLineDistances();
    course.slice(1).forEach((place, k) => {
      const star = this._label("operator", "★", 88, 30);
      star.position.set(...place);
      star.renderOrder = 8; // below numbers
      const number = this._label("operator", String(k + 1), 60, 26);
      number.position.set(...place);
      number.center.set(-0.15, 0.5);
      this.goals.push(number);
    });
  }

  _robots() {
    this.robots = this.at.map((_, i) => {
      const name = `robot-${i}`, { body, skin } = quadrotor(), { cone, skins } = cameraCone(this.flight.camera, this.fine === 1);
      skins.forEach((material) => this._paint(material, name));
      const trail = new L.Line2(new L.LineGeometry(), this._paint(new L.LineMaterial({ linewidth: 2, transparent: true, opacity: 0.7 }), name));
      trail.frustumCulled = false;
      const shadow = new L.Mesh(new L.CircleGeometry(1, 24), this._paint(flat(), "shadow"));
      const plumb = new L.LineSegments(points([[0, 0, 0], [0, 0, -1]]), this._paint(line(0.9), "shadow"));
      const robot = { body, cone, trail, shadow, plumb, alive: true }, shade = () => (robot.alive ? name : "faint");
      const ink = () => (robot.alive && this.fine < 1 ? "text" : shade()); // pale numbers are hard to read in a crowd
      robot.number = this._label(ink, String(i + 1), 64, 26 * Math.sqrt(this.fine));
      robot.number.center.set(0.5, -0.25);
      robot.repaint = () => skin.color.set(color(shade()));
      this.painters.push(robot.repaint);
      this._add(body, cone, trail, shadow, plumb);
      return robot;
    });
  }

  _links() {
    const pairs = (this.flight.n * (this.flight.n - 1)) / 2;
    this.tubes = this._add(sticks(new L.CylinderGeometry(1, 1, 1, 10, 1, true), pairs));
    this.heads = this._add(sticks(new L.ConeGeometry(1, 1, 16), pairs));
    this._paint(this.heads.material, "one-way");
    this.shaft = this._add(sticks(new L.CylinderGeometry(1, 1, 1, 12), 1));
    this.tip = this._add(sticks(new L.ConeGeometry(1, 1, 16), 1));
    this.ring = this._add(new L.Mesh(new L.TorusGeometry(1.9, 0.07, 8, 48), flat()));
    this.ring.visible = this.flight.led;
    [this.shaft, this.tip, this.ring].forEach((part) => this._paint(part.material, "leader"));
    this.painters.push(() => { this.shades = { mutual: new L.Color(color("mutual")), oneWay: new L.Color(color("one-way")) }; });
  }

  /** Colours of the theme anew. */
  repaint() {
    this.painters.forEach((paint) => paint());
  }

  resize() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!width || !height) return;
    this.renderer.setPixelRatio(Math.min(window.devicePixelRatio, 2));
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.camera.updateProjectionMatrix();
    this.height = height;
    const unit = (this._unit = (2 * Math.tan((this.camera.fov * Math.PI) / 360)) / height);
    for (const [sprite, pixels] of this.labels) sprite.scale.set(pixels * unit, pixels * unit, 1);
  }

  /** Metres a pixel at a place. */
  _pixel(place) {
    return (2 * Math.tan((this.camera.fov * Math.PI) / 360) * this.camera.position.distanceTo(place)) / this.height;
  }

  /** Move everything to a time, s. */
  show(time) {
    const { flight } = this, { n, poses, tilt } = flight, now = locate(flight, time);
    this.now = now;
    const turns = this.at.map((at, i) => {
      at.set(...[0, 1, 2].map((c) => between(poses, 4 * n, 4 * i + c, now)));
      const attitude = (k) => rotation(poses[4 * (k * n + i) + 3], tilt[2 * (k * n + i)], tilt[2 * (k * n + i) + 1]);
      const next = Math.min(now.k + 1, flight.time.length - 1);
      return attitude(now.k).slerp(attitude(next), now.share);
    });
    this._follow();
    this.robots.forEach((robot, i) => {
      const at = this.at[i], alive = aliveAt(flight, i, now);
      if (alive !== robot.alive) {
        robot.alive = alive;
        robot.repaint();
        robot.number.repaint();
      }
      for (const part of [robot.body, robot.cone]) {
        part.position.copy(at);
        part.quaternion.copy(turns[i]);
      }
      robot.number.position.copy(at);
      robot.shadow.position.set(at.x, at.y, flight.floor - 0.01);
      robot.plumb.position.copy(at);
      robot.plumb.scale.z = Math.max(at.z - flight.floor, 1e-3);
      if (robot.trail.visible) robot.trail.geometry.setPositions(this._past(i, time));
    });
  }

  /** Where robot i was in the last seconds, x, y, z, x, ... */
  _past(i, time) {
    const { poses, n } = this.flight, start = Math.max(0, time - TRAIL);
    return Array.from({ length: TRAIL_POINTS + 1 }, (_, p) => {
      const then = locate(this.flight, start + ((time - start) * p) / TRAIL_POINTS);
      return [0, 1, 2].map((c) => between(poses, 4 * n, 4 * i + c, then));
    }).flat();
  }

  /** Draw what the eye sees now: lines keep their width and robots their least size on the screen. */
  draw() {
    if (!this.height) return;
    this.robots.forEach((robot, i) => {
      const size = Math.max(HALF_WIDTH, LEAST * this._pixel(this.at[i]));
      robot.body.scale.setScalar(size);
      robot.shadow.scale.setScalar(0.8 * size);
    });
    this._drawLinks();
    this._drawStick();
    this._thin();
    this.renderer.render(this.scene, this.camera);
  }

  _drawLinks() {
    let tubes = 0, heads = 0;
    for (const [i, j, weight, own, other] of linksAt(this.flight, this.now)) {
      if (this.linked !== null && i !== this.linked && j !== this.linked) continue;
      const [eye, seen] = own ? [this.at[i], this.at[j]] : [this.at[j], this.at[i]], mutual = own && other;
      const middle = new L.Vector3().addVectors(eye, seen).divideScalar(2), radius = this.fine ** 2 * (0.7 + 2.2 * weight) * this._pixel(middle);
      let end = seen;
      if (!mutual) {
        const size = Math.max(2.4 * radius, 4.5 * this.fine * this._pixel(seen));
        const along = new L.Vector3().subVectors(eye, seen).normalize(), gap = 1.5 * this.robots[i].body.scale.x;
        const tip = new L.Vector3().copy(seen).addScaledVector(along, gap);
        end = new L.Vector3().copy(tip).addScaledVector(along, 2.6 * size);
        this.heads.lay(heads++, end, tip, size);
      }
      this.tubes.setColorAt(tubes, mutual ? this.shades.mutual : this.shades.oneWay);
      this.tubes.lay(tubes++, eye, end, radius);
    }
    this.tubes.count = tubes;
    this.heads.count = heads;
    if (this.tubes.instanceColor) this.tubes.instanceColor.needsUpdate = true;
  }

  _drawStick() {
    const { stick, led } = this.flight, leader = this.leader();
    this.ring.position.copy(this.at[leader]);
    this.ring.scale.setScalar(this.robots[leader].body.scale.x);
    const push = new L.Vector3(...[0, 1, 2].map((c) => between(stick, 3, c, this.now))), speed = push.length();
    this.shaft.count = this.tip.count = led && speed > 0.02 ? 1 : 0;
    if (!this.shaft.count) return;
    const at = this.at[leader], pixel = this._pixel(at);
    push.divideScalar(speed);
    const neck = new L.Vector3().copy(at).addScaledVector(push, 1.0 + 1.2 * speed);
    this.shaft.lay(0, at, neck, 2.5 * pixel);
    this.tip.lay(0, neck, new L.Vector3().copy(neck).addScaledVector(push, 18 * pixel), 7 * pixel);
  }

  /** Hide numbers that would stand on another: the leader's comes first, those of way points last. */
  _thin() {
    const leader = this.leader(), { aspect } = this.camera, taken = [];
    const numbers = [this.robots[leader], ...this.robots.filter((_, i) => i !== leader)].map((robot) => robot.number);
    this.camera.updateMatrixWorld();
    for (const number of [...numbers, ...this.goals]) {
      const { x, y, z } = number.position.clone().project(this.camera), size = number.scale.x / this._unit;
      const left = (x * aspect * this.height) / 2 - number.center.x * size, low = (y * this.height) / 2 - number.center.y * size;
      number.visible = z < 1 && taken.every(([u, v, wide]) => left > u + wide || u > left + size || Math.abs(low - v) > 0.7 * wide);
      if (number.visible) taken.push([left, low, size]);
    }
  }

  /** The robot that leads now. */
  leader() {
    return leaderAt(this.flight, this.now);
  }

  // ------------------------------------------------------------------------------------------------- where it looks
  /** Choose what to look at: "team", "leader", "all" or "above". */
  look(kind) {
    this.kind = kind;
    const whole = kind === "all", { low, high, floor } = this.flight;
    const radius = whole ? Math.hypot(high[0] - low[0], high[1] - low[1]) / 2 : kind === "leader" ? 6 : this.flight.spread + 1.5;
    const narrow = Math.min(1, this.camera.aspect || 1);
    const distance = (whole ? 0.8 : 1) * radius / Math.sin((this.camera.fov * Math.PI) / 360) / narrow;
    const above = kind === "above", azimuth = ((above ? -90 : -112) * Math.PI) / 180, elevation = ((above ? 89.9 : 38) * Math.PI) / 180;
    const target = whole ? new L.Vector3((low[0] + high[0]) / 2, (low[1] + high[1]) / 2, floor) : this._goal();
    this.followed = target.clone();
    this.controls.target.copy(target);
    this.camera.position.set(Math.cos(azimuth) * Math.cos(elevation), Math.sin(azimuth) * Math.cos(elevation), Math.sin(elevation))
      .multiplyScalar(distance).add(target);
    this.controls.update();
  }

  _goal() {
    if (this.kind === "leader") return this.at[this.leader()].clone();
    const middle = this.at.reduce((sum, at) => sum.add(at), new L.Vector3());
    return middle.divideScalar(this.at.length);
  }

  /** Move eye and target with what the view follows. */
  _follow() {
    if (!this.kind || this.kind === "all") return;
    const goal = this._goal(), shift = goal.clone().sub(this.followed);
    this.camera.position.add(shift);
    this.controls.target.add(shift);
    this.camera.lookAt(this.controls.target);
    this.followed = goal;
  }
}

/** Body to world: Rz(yaw) Ry(pitch) Rx(roll). */
function rotation(yaw, roll, pitch) {
  const turn = (x, y, z, angle) => new L.Quaternion().setFromAxisAngle(new L.Vector3(x, y, z), angle);
  return turn(0, 0, 1, yaw).multiply(turn(0, 1, 0, pitch)).multiply(turn(1, 0, 0, roll));
}
