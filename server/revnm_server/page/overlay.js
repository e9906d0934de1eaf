// Draws robots, goals, paths and previews over the picture, and turns places on the screen into pixels of the picture.

export const GOAL = "#ffcc33";
export const PATH = "#49a7ff";
export const SEEN = "#3fdc7f";
export const LOST = "#9aa5ad";

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

/** A canvas's pen on a clean sheet, in the screen's pixels, and how wide and high that is. */
export function fitted(canvas) {
  const ratio = window.devicePixelRatio || 1;
  const [wide, high] = [canvas.clientWidth, canvas.clientHeight];
  const [width, height] = [Math.round(wide * ratio), Math.round(high * ratio)];
  if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
  const pen = canvas.getContext("2d");
  pen.setTransform(1, 0, 0, 1, 0, 0);
  pen.clearRect(0, 0, width, height);
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  return { pen, wide, high };
}

/** Draw everything; `chosen` is the name of the robot that clicks are for, `quiet` whether the state is old. */
export function drawOverlay(canvas, state, { chosen, quiet, preview }) {
  const { pen } = fitted(canvas);
  const size = state.camera.size_px;
  if (!size) return;
  const place = placement(canvas, size);
  pen.translate(place.left, place.top);
  pen.lineJoin = pen.lineCap = "round";
  const last = (robot) => robot.name === chosen; // drawn over the others
  for (const robot of [...state.robots].sort((a, b) => last(a) - last(b))) {
    pen.globalAlpha = last(robot) ? 1 : 0.75;
    if (!quiet) drawPath(pen, robot, place.scale);
    if (robot.goal) drawGoal(pen, robot, place.scale);
    if (robot.pixel) drawRobot(pen, robot, place.scale, quiet);
  }
  pen.globalAlpha = 1;
  if (preview) drawPreview(pen, preview, place.scale, size);
}

/** Where the robot would stand: its circle on the floor, if that is known, and a crosshair through the picture. */
function drawPreview(pen, { target, ring, allowed }, scale, [width, height]) {
  const [x, y] = [target.u * scale, target.v * scale];
  const colour = allowed ? GOAL : LOST;
  pen.beginPath();
  pen.moveTo(0, y);
  pen.lineTo(width * scale, y);
  pen.moveTo(x, 0);
  pen.lineTo(x, height * scale);
  pen.setLineDash([2, 6]);
  stroke(pen, colour, 1);
  pen.setLineDash([]);
  pen.beginPath();
  if (ring.length > 0) {
    for (const { u, v } of ring) pen.lineTo(u * scale, v * scale);
    pen.closePath();
    pen.fillStyle = "rgba(255, 204, 51, .25)";
    pen.fill();
  } else pen.arc(x, y, 11, 0, 2 * Math.PI);
  stroke(pen, colour, 2.5);
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
