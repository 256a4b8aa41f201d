// What makes a robot look like a robot, as in the films: a bar along its front, and two wheels.

const FLIES = /^crazyflie/; // platforms without wheels

// Add the bar and wheels of a robot to paths. `c`, `s`: cosine and sine of its yaw, times its scale.
export function addBody(bars, wheels, { x, y, platform, footprint }, c, s) {
  const [us, vs] = [0, 1].map((axis) => footprint.map((corner) => corner[axis]));
  const [back, front, right, left] = [Math.min(...us), Math.max(...us), Math.min(...vs), Math.max(...vs)];
  const length = front - back, width = left - right;
  const box = (path, u, v, long, wide) => {
    [[-1, -1], [1, -1], [1, 1], [-1, 1]].forEach(([a, b], i) => {
      const [m, n] = [u + a * long, v + b * wide];
      path[i ? 'lineTo' : 'moveTo'](x + c * m - s * n, y + s * m + c * n);
    });
    path.closePath();
  };
  // Shares of the sides, as in the films; the wheels are wider, since they are seen from above alone.
  box(bars, front - 0.16 * length, (left + right) / 2, 0.07 * length, 0.3 * width);
  if (FLIES.test(platform)) return;
  for (const v of [right, left]) box(wheels, 0, v, Math.min(0.25 * length, 0.3 * width), 0.09 * width);
}
