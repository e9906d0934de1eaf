// Draws robots, goals and paths over the picture, and turns places on the screen into pixels of the picture.

const GOAL = "#ffcc33";
const PATH = "#49a7ff";
const SEEN = "#3fdc7f";
const LOST = "#9aa5ad";

/** Where a picture of size [w, h] lies inside an element, as object-fit: contain places it. */
export function placement(element, [width, height]) {
  const scale = Math.min(element.clientWidth / width, element.clientHeight / height);
  return {
    scale,
    left: (element.clientWidth - width * scale) / 2,
    top: (element.clientHeight - height * scale) / 2,
  };
}

/** The pixel {u, v} under a pointer, or null beside the picture. */
export function pixelAt(event, canvas, size) {
  const box = canvas.getBoundingClientRect();
  const place = placement(canvas, size);
  const u = (event.clientX - box.left - place.left) / place.scale;
  const v = (event.clientY - box.top - place.top) / place.scale;
  return u >= 0 && v >= 0 && u < size[0] && v < size[1] ? { u, v } : null;
}

/** Draw everything; `chosen` is the name of the robot that clicks are for, `quiet` whether the state is old. */
export function draw(canvas, state, { chosen, quiet }) {
  const ratio = window.devicePixelRatio || 1;
  const [width, height] = [Math.round(canvas.clientWidth * ratio), Math.round(canvas.clientHeight * ratio)];
  if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
  const pen = canvas.getContext("2d");
  pen.setTransform(1, 0, 0, 1, 0, 0);
  pen.clearRect(0, 0, width, height);
  const size = state.camera.size_px;
  if (!size) return;
  const place = placement(canvas, size);
  pen.setTransform(ratio, 0, 0, ratio, place.left * ratio, place.top * ratio);
  pen.lineJoin = pen.lineCap = "round";
  for (const robot of state.robots) {
    pen.globalAlpha = robot.name === chosen ? 1 : 0.55;
    if (!quiet) drawPath(pen, robot, place.scale);
    if (robot.goal) drawGoal(pen, robot, place.scale);
    if (robot.pixel) drawRobot(pen, robot, place.scale, quiet);
  }
}

function stroke(pen, colour, width) {
  pen.strokeStyle = "rgba(0,0,0,.6)";
  pen.lineWidth = width + 3;
  pen.stroke();
  pen.strokeStyle = colour;
  pen.lineWidth = width;
  pen.stroke();
}

function drawPath(pen, robot, scale) {
  if (!robot.pixel || robot.path_px.length === 0) return;
  pen.beginPath();
  pen.moveTo(robot.pixel[0] * scale, robot.pixel[1] * scale);
  for (const [u, v] of robot.path_px) pen.lineTo(u * scale, v * scale);
  stroke(pen, PATH, 3);
  pen.fillStyle = PATH;
  for (const [u, v] of robot.path_px) {
    pen.beginPath();
    pen.arc(u * scale, v * scale, 4, 0, 2 * Math.PI);
    pen.fill();
  }
}

function drawGoal(pen, robot, scale) {
  const [x, y] = [robot.goal.u * scale, robot.goal.v * scale];
  const arrived = robot.status === "arrived";
  pen.beginPath();
  pen.arc(x, y, arrived ? 20 : 11, 0, 2 * Math.PI);
  for (const [dx, dy] of arrived ? [] : [[1, 0], [-1, 0], [0, 1], [0, -1]]) {
    pen.moveTo(x + 6 * dx, y + 6 * dy);
    pen.lineTo(x + 17 * dx, y + 17 * dy);
  }
  stroke(pen, arrived ? SEEN : GOAL, 2.5);
}

function drawRobot(pen, robot, scale, quiet) {
  const [x, y] = [robot.pixel[0] * scale, robot.pixel[1] * scale];
  const fresh = !quiet && robot.sighting_age_s !== null && robot.sighting_age_s < 1;
  const colour = fresh ? SEEN : LOST;
  pen.beginPath();
  pen.arc(x, y, 13, 0, 2 * Math.PI);
  if (robot.heading) {
    const [du, dv] = robot.heading;
    pen.moveTo(x + 13 * du, y + 13 * dv);
    pen.lineTo(x + 36 * du, y + 36 * dv);
    pen.moveTo(x + 27 * du - 7 * dv, y + 27 * dv + 7 * du);
    pen.lineTo(x + 36 * du, y + 36 * dv);
    pen.lineTo(x + 27 * du + 7 * dv, y + 27 * dv - 7 * du);
  }
  stroke(pen, colour, 3);
  drawLabel(pen, fresh ? robot.name : `${robot.name} (last seen)`, { x, y: labelY(robot, y), colour });
}

/** The label keeps out of the way of the arrow. */
function labelY(robot, y) {
  return robot.heading && robot.heading[1] > 0 ? y - 34 : y + 34;
}

function drawLabel(pen, text, { x, y, colour }) {
  pen.font = "600 13px system-ui, sans-serif";
  pen.textAlign = "center";
  pen.textBaseline = "middle";
  const width = pen.measureText(text).width + 16;
  pen.fillStyle = "rgba(14,17,20,.85)";
  pen.beginPath();
  pen.roundRect(x - width / 2, y - 11, width, 22, 11);
  pen.fill();
  pen.fillStyle = colour;
  pen.fillText(text, x, y + 1);
}
