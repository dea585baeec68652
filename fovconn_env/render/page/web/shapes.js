"use strict";
// What the 3-D view is built of. Body frame: x ahead, y left, z up; m.

const L = libraries;
const STUB = 1.5; // m, the part of a camera's view that is drawn strong

function flat(opacity = 1) {
  const glass = opacity < 1;
  return new L.MeshBasicMaterial({ side: L.DoubleSide, transparent: glass, opacity, depthWrite: !glass });
}

function line(opacity = 1) {
  return new L.LineBasicMaterial({ transparent: opacity < 1, opacity });
}

function points(list) {
  const geometry = new L.BufferGeometry();
  geometry.setAttribute("position", new L.BufferAttribute(new Float32Array(list.flat()), 3));
  return geometry;
}

/** Triangles from one corner to each pair of neighbours on a rim. */
function fanned(apex, rim) {
  return points(rim.slice(1).flatMap((corner, k) => [apex, rim[k], corner]));
}

/** A quadrotor of half-width 1: four rings, arms, a hull, and a nose towards x. */
function quadrotor() {
  const body = new L.Group(), skin = new L.MeshLambertMaterial();
  const add = (geometry, place) => {
    const part = new L.Mesh(geometry, skin);
    place(part);
    body.add(part);
  };
  for (const [x, y] of [[0.62, 0.62], [-0.62, 0.62], [-0.62, -0.62], [0.62, -0.62]]) {
    add(new L.TorusGeometry(0.4, 0.07, 6, 24), (part) => part.position.set(x, y, 0.12));
    add(new L.CylinderGeometry(0.06, 0.06, Math.hypot(x, y)), (part) => {
      part.position.set(x / 2, y / 2, 0.05);
      part.rotation.z = Math.atan2(y, x) - Math.PI / 2;
    });
  }
  add(new L.CylinderGeometry(0.36, 0.3, 0.26, 12), (part) => { part.rotation.x = Math.PI / 2; });
  add(new L.ConeGeometry(0.3, 1.1, 12), (part) => { part.position.x = 1.0; part.rotation.z = -Math.PI / 2; });
  return { body, skin };
}

/** The field of view: a strong cone near the robot, and, if it reaches, a sector out to the camera's range. */
function cameraCone({ axis, a_min, d_max }, reaches) {
  const ahead = new L.Vector3(...axis), up = new L.Vector3(0, 0, 1);
  const side = new L.Vector3().crossVectors(up, ahead);
  if (side.length() < 1e-6) side.set(0, 1, 0);
  side.normalize();
  const third = new L.Vector3().crossVectors(ahead, side), reach = Math.sqrt(1 - a_min * a_min);
  const mix = (length, c, s, t) => new L.Vector3()
    .addScaledVector(ahead, length * c).addScaledVector(side, length * s).addScaledVector(third, length * t).toArray();
  const turn = (k, n) => (2 * Math.PI * k) / n;
  const rim = Array.from({ length: 49 }, (_, k) => mix(STUB, a_min, reach * Math.cos(turn(k, 48)), reach * Math.sin(turn(k, 48))));
  const half = Math.acos(a_min);
  const arc = Array.from({ length: 41 }, (_, k) => mix(d_max, Math.cos(half * (k / 20 - 1)), Math.sin(half * (k / 20 - 1)), 0));
  const parts = [new L.Mesh(fanned([0, 0, 0], rim), flat(0.16)), new L.Line(points(rim), line(0.65))];
  if (reaches) {
    parts.push(new L.Mesh(fanned([0, 0, 0], arc), flat(0.05)), new L.Line(points([[0, 0, 0], ...arc, [0, 0, 0]]), line(0.3)));
  }
  const cone = new L.Group();
  cone.add(...parts);
  return { cone, skins: parts.map((part) => part.material) };
}

/** An upright prism over a plan [[x, y], ...], and its edges. */
function prism({ plan, low, high }) {
  const shape = new L.Shape(plan.map(([x, y]) => new L.Vector2(x, y)));
  const solid = new L.ExtrudeGeometry(shape, { depth: high - low, bevelEnabled: false });
  const block = new L.Group(), skin = new L.MeshLambertMaterial({ transparent: true, opacity: 0.85 }), edge = line();
  block.add(new L.Mesh(solid, skin), new L.LineSegments(new L.EdgesGeometry(solid, 30), edge));
  block.position.z = low;
  return { block, skin, edge };
}

/** A word that stays upright, in front and of one size; `paint(word, color, halo)` draws it anew. */
function label() {
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = 96;
  const map = new L.CanvasTexture(canvas);
  map.colorSpace = L.SRGBColorSpace;
  const sprite = new L.Sprite(new L.SpriteMaterial({ map, depthTest: false, depthWrite: false, sizeAttenuation: false }));
  sprite.renderOrder = 9;
  const paint = (word, ink, halo, size = 52) => {
    const pen = canvas.getContext("2d");
    pen.clearRect(0, 0, 96, 96);
    pen.font = `bold ${size}px system-ui, sans-serif`;
    pen.textAlign = "center";
    pen.textBaseline = "middle";
    pen.lineWidth = 12;
    pen.lineJoin = "round";
    pen.strokeStyle = halo;
    pen.strokeText(word, 48, 48);
    pen.fillStyle = ink;
    pen.fillText(word, 48, 48);
    map.needsUpdate = true;
  };
  return { sprite, paint };
}

/** Many tubes or cones in one call; `lay(k, from, to, radius)` stretches number k between two points. */
function sticks(geometry, count) {
  const mesh = new L.InstancedMesh(geometry, new L.MeshBasicMaterial(), count);
  mesh.frustumCulled = false;
  const up = new L.Vector3(0, 1, 0), along = new L.Vector3(), matrix = new L.Matrix4(), turn = new L.Quaternion();
  const middle = new L.Vector3(), scale = new L.Vector3();
  mesh.lay = (k, from, to, radius) => {
    const length = along.subVectors(to, from).length();
    turn.setFromUnitVectors(up, along.divideScalar(Math.max(length, 1e-9)));
    matrix.compose(middle.addVectors(from, to).divideScalar(2), turn, scale.set(radius, length, radius));
    mesh.setMatrixAt(k, matrix);
    mesh.instanceMatrix.needsUpdate = true;
  };
  return mesh;
}
