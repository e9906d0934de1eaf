// Where pixels lie on the floor, by what the server has learnt of its camera: see server/revnm_server/floor_camera.py.
//
// Pixels {u, v} have the picture's edges at integers. The floor's frame lies under the camera: x ahead, y left, metres.

const RING_POINTS = 40;
const LEAST_DEPTH_M = 0.05;

/** The point [x, y] of the floor that is seen at a pixel; null on or above the horizon. */
export function onFloor(camera, [width, height], { u, v }) {
  const right = (u - width / 2) / (width / 2);
  const down = (v - height / 2) / (width / 2);
  const focal = camera.focal_px / (width / 2);
  const ahead = focal * (1 + camera.distortion * (right * right + down * down));
  const axes = directions(camera);
  const ray = [0, 1, 2].map((i) => right * axes.right[i] + down * axes.down[i] + ahead * axes.ahead[i]);
  if (ahead <= 0 || ray[2] > -1e-6 * Math.hypot(right, down, ahead)) return null;
  const reach = -camera.height_m / ray[2];
  return [ray[0] * reach, ray[1] * reach];
}

/** The pixel at which a point of the floor is seen; null behind the camera. */
export function inPicture(camera, [width, height], [x, y]) {
  const axes = directions(camera);
  const [right, down, ahead] = [axes.right, axes.down, axes.ahead].map(
    (axis) => x * axis[0] + y * axis[1] - camera.height_m * axis[2],
  );
  if (ahead < LEAST_DEPTH_M) return null;
  const focal = camera.focal_px / (width / 2);
  const strength = (camera.distortion * focal * focal * (right * right + down * down)) / (ahead * ahead);
  const bent = 2 / (1 + Math.sqrt(Math.max(1 - 4 * strength, 0)));
  const scale = ((width / 2) * focal * bent) / ahead;
  return { u: width / 2 + scale * right, v: height / 2 + scale * down };
}

/** A circle on the floor around what is seen at a pixel, as pixels; empty where that is not on the floor. */
export function ringInPicture(camera, size, pixel, radiusM) {
  const middle = onFloor(camera, size, pixel);
  if (!middle) return [];
  const ring = Array.from({ length: RING_POINTS }, (_, i) => {
    const angle = (2 * Math.PI * i) / RING_POINTS;
    return inPicture(camera, size, [middle[0] + radiusM * Math.cos(angle), middle[1] + radiusM * Math.sin(angle)]);
  });
  return ring.every((point) => point) ? ring : [];
}

/** The picture's axes on the floor's frame. */
function directions({ pitch_rad: pitch, roll_rad: roll }) {
  const [cp, sp, cr, sr] = [Math.cos(pitch), Math.sin(pitch), Math.cos(roll), Math.sin(roll)];
  return { right: [-sr * sp, -cr, -sr * cp], down: [-cr * sp, sr, -cr * cp], ahead: [cp, 0, -sp] };
}
