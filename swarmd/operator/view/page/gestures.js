// Gestures on the map by touch, mouse, wheel and keys: move, zoom, select, measure, align robots.

export class Gestures {
  constructor(map) {
    this.map = map;
    this.pointers = new Map();
    this.hasMoved = false;
    this.grabbed = null; // the robot that is dragged
    const { canvas } = map;
    canvas.addEventListener('pointerdown', (event) => this.down(event));
    canvas.addEventListener('pointermove', (event) => this.move(event));
    for (const end of ['pointerup', 'pointercancel']) canvas.addEventListener(end, (event) => this.up(event));
    canvas.addEventListener('wheel', (event) => this.wheel(event), { passive: false });
    canvas.addEventListener('keydown', (event) => this.key(event));
  }

  robotAt(event) {
    const [x, y] = this.map.toWorld(event), reach = Math.max(14 / this.map.scale, 0);
    let best = null, least = Infinity;
    for (const robot of this.map.model.robots.values()) {
      const far = Math.hypot(robot.x - x, robot.y - y);
      if (far < Math.max(robot.radius, reach) && far < least) { best = robot; least = far; }
    }
    return best;
  }

  down(event) {
    this.map.canvas.setPointerCapture(event.pointerId);
    this.pointers.set(event.pointerId, [event.clientX, event.clientY]);
    this.hasMoved = false;
    this.grabbed = this.map.mode === 'align' ? this.robotAt(event) : null;
    if (this.map.mode === 'measure') this.map.ruler = [this.map.toWorld(event), this.map.toWorld(event)];
    this.map.canvas.focus({ preventScroll: true });
  }

  move(event) {
    const last = this.pointers.get(event.pointerId);
    if (!last) { this.hover(event); return; }
    const [dx, dy] = [event.clientX - last[0], event.clientY - last[1]];
    if (Math.hypot(dx, dy) < 3 && !this.hasMoved) return;
    this.hasMoved = true;
    this.pointers.set(event.pointerId, [event.clientX, event.clientY]);
    if (this.pointers.size === 2) this.pinch(event, last);
    else if (this.map.mode === 'measure') this.map.ruler[1] = this.map.toWorld(event);
    else if (this.grabbed) this.drag(dx / this.map.scale, -dy / this.map.scale);
    else if (this.map.mode === 'align' && this.map.model.selected.size) this.turn(last, event);
    else {
      this.map.centre = [this.map.centre[0] - dx / this.map.scale, this.map.centre[1] + dy / this.map.scale];
      this.map.isTouched = true;
    }
    this.map.wake();
  }

  // Show the name of the robot below the mouse.
  hover(event) {
    const robot = event.pointerType === 'mouse' ? this.robotAt(event) : null;
    if (robot === this.map.hovered) return;
    this.map.hovered = robot;
    this.map.wake();
  }

  // Move the frame of the selected robots' odometry.
  drag(dx, dy) {
    const isSelected = this.map.model.selected.has(this.grabbed.name);
    for (const robot of isSelected ? this.map.chosen() : [this.grabbed]) {
      robot.x += dx; robot.y += dy;
      const [x, y, turn] = this.map.model.shiftOf(robot);
      robot.offset = [x + dx, y + dy, turn];
      robot.trail.length = 0;
    }
  }

  // Turn the selected robots together, by a drag around their middle.
  turn(last, event) {
    const robots = this.map.chosen();
    if (!robots.length) return;
    const mean = (key) => robots.reduce((sum, one) => sum + one[key], 0) / robots.length;
    const [mx, my] = [mean('x'), mean('y')];
    const bearing = (x, y) => Math.atan2(y - my, x - mx);
    const angle = bearing(...this.map.toWorld(event)) - bearing(...this.map.toWorld({ clientX: last[0], clientY: last[1] }));
    const c = Math.cos(angle), s = Math.sin(angle);
    const turned = (x, y) => [mx + c * (x - mx) - s * (y - my), my + s * (x - mx) + c * (y - my)];
    for (const robot of robots) {
      const [x, y, turn] = this.map.model.shiftOf(robot);
      robot.offset = [...turned(x, y), turn + angle];
      [robot.x, robot.y] = turned(robot.x, robot.y);
      robot.yaw += angle;
      robot.trail.length = 0;
    }
  }

  pinch(event, last) {
    const other = [...this.pointers].find(([id]) => id !== event.pointerId)[1];
    const before = Math.hypot(last[0] - other[0], last[1] - other[1]);
    const after = Math.hypot(event.clientX - other[0], event.clientY - other[1]);
    this.map.isTouched = true;
    if (before > 0) this.map.scale = Math.min(Math.max(this.map.scale * after / before, 1), 2000);
  }

  up(event) {
    if (this.pointers.has(event.pointerId) && !this.hasMoved && this.map.mode !== 'measure') {
      const robot = this.robotAt(event);
      const adds = event.shiftKey || event.ctrlKey || event.metaKey;
      if (robot) this.map.model.select([robot.name], adds);
      else if (!adds) this.map.model.select([]);
    }
    if (this.map.mode === 'align' && this.hasMoved) this.map.model.keepOffsets();
    this.pointers.delete(event.pointerId);
    this.grabbed = null;
  }

  wheel(event) {
    event.preventDefault();
    const before = this.map.toWorld(event);
    this.map.scale = Math.min(Math.max(this.map.scale * Math.exp(-event.deltaY / 500), 1), 2000);
    const after = this.map.toWorld(event);
    this.map.centre = [this.map.centre[0] + before[0] - after[0], this.map.centre[1] + before[1] - after[1]];
    this.map.isTouched = true;
    this.map.wake();
  }

  key(event) {
    const step = 60 / this.map.scale;
    const moves = { ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, step], ArrowDown: [0, -step] };
    if (moves[event.key]) this.map.centre = [this.map.centre[0] + moves[event.key][0], this.map.centre[1] + moves[event.key][1]];
    else if (event.key === '+' || event.key === '=') this.map.scale *= 1.25;
    else if (event.key === '-') this.map.scale /= 1.25;
    else return;
    event.preventDefault();
    this.map.isTouched = true;
    this.map.wake();
  }
}
