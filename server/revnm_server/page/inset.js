// Draws what a robot's LiDAR sees around it: the robot in the middle, its front up, its plan, and its way to a stop.

import { fitted, GOAL, LOST, PATH, SEEN } from "./overlay.js";

const REACH_M = 3;
const OLD_S = 0.6; // robots stand with scans older than 0.3 s
const MARGIN_M = 0.03;
const GRID = "#2c343b";
const HIT = "#e9edf0";
const ZONE = "rgba(229, 72, 77, .35)";

/** Draw a robot's scan; `quiet` says that the state is old. */
export function drawInset(canvas, robot, [length, width], quiet) {
  const { pen, wide, high } = fitted(canvas);
  const scale = Math.min(wide, high) / (2 * REACH_M); // pixels a metre
  // x forward is up, y left is left.
  const put = ([x, y]) => [wide / 2 - y * scale, high / 2 - x * scale];
  const old = quiet || !robot.scan || robot.scan.age_s > OLD_S;
  drawGrid(pen, put, scale);
  pen.globalAlpha = old ? 0.35 : 1;
  drawZone(pen, put, scale, robot.robot_state, [length, width]);
  drawBody(pen, put, scale, [length, width]);
  if (!quiet) drawPlan(pen, put, robot.waypoints_m);
  pen.fillStyle = old ? LOST : HIT;
  for (const point of robot.scan?.points_m ?? []) {
    const [x, y] = put(point);
    pen.fillRect(x - 1.25, y - 1.25, 2.5, 2.5);
  }
  pen.globalAlpha = 1;
}

/** What the drawing shows, in words. */
export function insetCaption(robot, quiet) {
  if (!robot.scan) return "The server hears no scans of this robot.";
  if (quiet || robot.scan.age_s > OLD_S) return `Scan is ${quiet ? "old" : `${robot.scan.age_s.toFixed(1)} s old`}.`;
  const near = robot.scan.points_m.reduce((best, p) => (Math.hypot(...p) < Math.hypot(...best) ? p : best), [99, 0]);
  if (near[0] === 99) return "LiDAR: nothing in reach.";
  return `Nearest ${Math.hypot(...near).toFixed(2)} m, ${side(near)}. Rings: 1 m.`;
}

function side([x, y]) {
  const angle = (Math.atan2(y, x) * 180) / Math.PI;
  if (Math.abs(angle) <= 45) return "ahead";
  if (Math.abs(angle) >= 135) return "behind";
  return angle > 0 ? "left" : "right";
}

function drawGrid(pen, put, scale) {
  pen.strokeStyle = GRID;
  pen.lineWidth = 1;
  for (let radius = 1; radius <= REACH_M; radius++) {
    pen.beginPath();
    pen.arc(...put([0, 0]), radius * scale - 0.5, 0, 2 * Math.PI);
    pen.stroke();
  }
}

/** Where the robot still comes if it is told to stand now. */
function drawZone(pen, put, scale, own, [length, width]) {
  if (typeof own?.stopping_m !== "number") return;
  const back = own.v_mps < 0;
  const [front, rear] = back ? [MARGIN_M, own.stopping_m] : [own.stopping_m, MARGIN_M];
  const [left, top] = put([length / 2 + front, width / 2 + MARGIN_M]);
  pen.fillStyle = ZONE;
  pen.fillRect(left, top, (width + 2 * MARGIN_M) * scale, (length + front + rear) * scale);
}

function drawBody(pen, put, scale, [length, width]) {
  const [left, top] = put([length / 2, width / 2]);
  pen.strokeStyle = SEEN;
  pen.lineWidth = 2;
  pen.strokeRect(left, top, width * scale, length * scale);
  pen.beginPath();
  pen.moveTo(...put([0, 0]));
  pen.lineTo(...put([length / 2, 0]));
  pen.stroke();
}

function drawPlan(pen, put, waypoints) {
  if (waypoints.length === 0) return;
  pen.beginPath();
  pen.moveTo(...put([0, 0]));
  for (const point of waypoints) pen.lineTo(...put(point));
  pen.strokeStyle = PATH;
  pen.lineWidth = 2.5;
  pen.stroke();
  pen.beginPath();
  pen.arc(...put(waypoints.at(-1)), 3.5, 0, 2 * Math.PI);
  pen.fillStyle = GOAL;
  pen.fill();
}
