// Bodies in space, painted from the farthest to the nearest.
"use strict";

const CIRCLE = [...Array(48).keys()].map((i) => (Math.PI * i) / 24);
let azimuth, elevation;

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const plus = (a, b) => a.map((value, i) => value + b[i]);
const times = (s, a) => a.map((value) => s * value);

// Unit vectors to the right, upwards and towards the eye.
function eyeOf(around, above) {
  const c = Math.cos(around), s = Math.sin(around), flat = Math.cos(above), high = Math.sin(above);
  return [[-s, c, 0], [-high * c, -high * s, flat], [flat * c, flat * s, high]];
}

// Columns of the rotation of a quaternion, which need not be of unit length.
function axesOf([w, x, y, z]) {
  const s = 2 / (w * w + x * x + y * y + z * z);
  return [
    [1 - s * (y * y + z * z), s * (x * y + w * z), s * (x * z - w * y)],
    [s * (x * y - w * z), 1 - s * (x * x + z * z), s * (y * z + w * x)],
    [s * (x * z + w * y), s * (y * z - w * x), 1 - s * (x * x + y * y)],
  ];
}

const inWorld = (axes, p) => plus(plus(times(p[0], axes[0]), times(p[1], axes[1])), times(p[2], axes[2]));

function pieceOf(points, fill, seen) {
  const depth = points.reduce((sum, point) => sum + dot(point, seen), 0) / points.length;
  return { points, fill, depth };
}

// Whether a face of a convex body is seen: its outer normal points at the eye.
function isSeen([a, b, c], centre, seen) {
  const u = plus(b, times(-1, a)), v = plus(c, times(-1, a));
  const normal = [u[1] * v[2] - u[2] * v[1], u[2] * v[0] - u[0] * v[2], u[0] * v[1] - u[1] * v[0]];
  return dot(normal, plus(a, times(-1, centre))) * dot(normal, seen) > 0;
}

function facePieces(centre, axes, { corners, faces }, fill, seen) {
  const moved = corners.map((corner) => plus(centre, inWorld(axes, corner)));
  return faces.map((face) => face.map((i) => moved[i]))
    .filter((points) => isSeen(points, centre, seen))
    .map((points) => pieceOf(points, fill, seen));
}

// An outline, and the near halves of two great circles that turn with the ball.
function ballPieces(centre, axes, radius, fill, [right, up, seen]) {
  const ring = (one, two) => CIRCLE.map((a) => plus(times(radius * Math.cos(a), one), times(radius * Math.sin(a), two)));
  const outline = pieceOf(ring(right, up).map((arm) => plus(centre, arm)), fill, seen);
  const halves = [1, 2].map((other) => {
    const arms = ring(axes[0], axes[other]), isNear = arms.map((arm) => dot(arm, seen) >= 0);
    const first = isNear.findIndex((near, i) => near && !isNear.at(i - 1));
    const turned = arms.map((_, i) => (first + i) % arms.length).filter((i) => isNear[i]);
    const points = turned.map((i) => plus(centre, arms[i]));
    return { points, fill: null, depth: outline.depth + 1e-9 };
  });
  return [outline, ...halves.filter((piece) => piece.points.length)];
}

function bodyPieces(q, body, eye) {
  const pose = q.slice(7 * body, 7 * body + 7), axes = axesOf(pose.slice(3));
  const fill = data.colours[body % data.colours.length], centre = pose.slice(0, 3);
  const solid = data.space.solids[body];
  if (solid.radius) return ballPieces(centre, axes, solid.radius, fill, eye);
  return facePieces(centre, axes, solid, fill, eye[2]);
}

function drawSpace(to, q) {
  if (azimuth === undefined) [azimuth, elevation] = data.space.eye;
  const eye = eyeOf(azimuth, elevation), first = eyeOf(...data.space.eye), middle = data.space.middle;
  const shift = [0, 1].map((i) => dot(first[i], middle) - dot(eye[i], middle));
  const at = (point) => to.at(dot(eye[0], point) + shift[0], dot(eye[1], point) + shift[1]);
  pen.strokeStyle = ink.earth;
  for (const line of data.space.lines) {
    path([at(line.slice(0, 3)), at(line.slice(3))], false);
    pen.stroke();
  }
  const pieces = data.space.solids.flatMap((_, body) => bodyPieces(q, body, eye));
  for (const [body, ...point] of data.space.pins) {
    const centre = q.slice(7 * body, 7 * body + 3);
    const held = plus(centre, inWorld(axesOf(q.slice(7 * body + 3, 7 * body + 7)), point));
    pieces.push(pieceOf([held, centre], null, eye[2]));
  }
  pieces.sort((a, b) => a.depth - b.depth);
  pen.strokeStyle = ink.ink;
  for (const piece of pieces) {
    path(piece.points.map(at), piece.fill !== null);
    if (piece.fill !== null) {
      pen.fillStyle = piece.fill;
      pen.fill();
    }
    pen.stroke();
  }
  pen.strokeStyle = pen.fillStyle = ink.sticks;
  data.forces[frame].forEach((force, body) => drawSum(at, eye, q.slice(7 * body, 7 * body + 3), force));
}

// As long as it is large, seen from where we are.
function drawSum(at, eye, centre, force) {
  const x = dot(eye[0], force), y = dot(eye[1], force), size = Math.hypot(x, y) / data.largest;
  if (size < 1e-3) return;
  drawArrow(...at(centre), Math.atan2(-y, x), 0.25 * canvas.height * Math.min(size, 1.5), []);
}

function turn(event) {
  azimuth -= (3 * event.movementX) / canvas.clientWidth;
  elevation = Math.min(Math.max(elevation + (3 * event.movementY) / canvas.clientHeight, -0.2), 1.5);
  soon();
}
