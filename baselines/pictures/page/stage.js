// One view: what stands around the flap, the jaws, the camera that orbits, the words beside things.

const FIELD_OF_VIEW = 28; // degrees
const FILLED = 0.9; // part of the picture that things fill when all are looked at

/** Across, the middle, and along, the distance, from which places (across, along) lie within a slope. */
function fitted(across, along, slope) {
  const high = Math.max(...across.map((a, k) => a + slope * along[k]));
  const low = Math.min(...across.map((a, k) => a - slope * along[k]));
  return [(high + low) / 2, (high - low) / (2 * slope)];
}

class Stage {
  constructor(holder, scene, palette, onTurn) {
    this.holder = holder;
    this.palette = palette;
    this.canvas = holder.querySelector("canvas");
    this.renderer = new THREE.WebGLRenderer({ canvas: this.canvas, antialias: true, preserveDrawingBuffer: true });
    this.renderer.setPixelRatio(Math.min(2, window.devicePixelRatio));
    this.world = new THREE.Scene();
    this.camera = new THREE.PerspectiveCamera(FIELD_OF_VIEW, 1, 1, 1e4);
    this.world.add(new THREE.AmbientLight(0xffffff, 2.1));
    const sun = new THREE.DirectionalLight(0xffffff, 1.3);
    sun.position.set(-0.5, 1, 0.7);
    this.world.add(sun);
    this.controls = new THREE.OrbitControls(this.camera, this.canvas);
    this.controls.enableZoom = false; // until the picture has the focus: the wheel scrolls the page
    this.canvas.addEventListener("pointerdown", () => this.canvas.focus({ preventScroll: true }));
    this.canvas.addEventListener("focus", () => { this.controls.enableZoom = true; });
    this.canvas.addEventListener("blur", () => { this.controls.enableZoom = false; });
    // a finger that goes up or down scrolls the page, one that goes sideways turns the flap
    this.canvas.style.touchAction = "pan-y";
    this.controls.addEventListener("change", () => onTurn(this));
    this.labels = [];
    this.flap = null;
    this.furnish(scene);
  }

  /** Stand another scene around the flap. */
  furnish(scene) {
    if (this.scene === scene) return;
    this.scene = scene;
    if (this.around) this.world.remove(this.around);
    for (const label of this.labels) label.element.remove();
    this.labels = [];
    this.around = new THREE.Group();
    this.world.add(this.around);
    const { length, height, depth, target, sight } = scene;
    const { SIGHT, HATCH } = this.palette;
    this.bed = new THREE.Mesh(
      new THREE.PlaneGeometry(2 * length, depth + 0.9 * length),
      new THREE.MeshBasicMaterial({ side: THREE.DoubleSide, transparent: !scene.bed, opacity: scene.bed ? 1 : 0.4 }),
    );
    this.bed.rotation.x = -Math.PI / 2;
    this.bed.position.set(-0.65 * length, -0.004 * length, 0);
    const block = new THREE.Mesh(
      new THREE.BoxGeometry(0.14 * length, height, depth + 0.08 * length), new THREE.MeshLambertMaterial({ color: HATCH }),
    );
    block.position.set(0.07 * length, height / 2, 0);
    const interest = new THREE.Mesh(
      new THREE.PlaneGeometry(length + target[0], depth),
      new THREE.MeshBasicMaterial({ color: SIGHT, side: THREE.DoubleSide, polygonOffset: true, polygonOffsetFactor: -2, polygonOffsetUnits: -2 }),
    );
    interest.rotation.x = -Math.PI / 2;
    interest.position.set((target[0] - length) / 2, -0.002 * length, 0);
    this.around.add(this.bed, block, interest);
    this.addSight(target, sight, depth, length, SIGHT);
    this.jaws = [1, -1].map((side) => {
      const jaw = new THREE.Group();
      jaw.add(new THREE.Mesh(drawnOut(scene.finger, side, Math.min(0.4 * scene.jawDepth, 0.035 * length)), new THREE.MeshLambertMaterial({ side: THREE.DoubleSide })));
      jaw.add(new THREE.Mesh(drawnOut(scene.pad, side, scene.jawDepth + 0.012 * length), new THREE.MeshLambertMaterial({ side: THREE.DoubleSide })));
      this.around.add(jaw);
      return jaw;
    });
    this.label("B", [target[0], -0.01 * length, depth / 2], "below");
    this.label(scene.cameraShown ? "camera A" : "to camera A", [...sight, 0], "above");
    this.label("fixed end", [0.07 * length, height, 0], "above");
    this.paintScheme();
  }

  /** The line AB, the plane above which all tissue has to end, and where the camera is. */
  addSight(target, sight, depth, length, colour) {
    const [b, a] = [new THREE.Vector3(...target, 0), new THREE.Vector3(...sight, 0)];
    const way = a.clone().sub(b);
    const upright = (thing, middle) => {
      thing.quaternion.setFromUnitVectors(new THREE.Vector3(0, 1, 0), way.clone().normalize());
      thing.position.copy(middle);
      this.around.add(thing);
    };
    const look = new THREE.MeshBasicMaterial({ color: colour });
    const middle = a.clone().add(b).multiplyScalar(0.5);
    const line = new THREE.Mesh(new THREE.CylinderGeometry(0.0035 * length, 0.0035 * length, way.length(), 8), look);
    const tip = new THREE.Mesh(new THREE.ConeGeometry(0.015 * length, 0.045 * length, 16), look);
    upright(line, middle);
    upright(tip, a);
    this.inTheWay = { things: [line, tip], way: way.clone().normalize() };
    const dot = new THREE.Mesh(new THREE.SphereGeometry(0.012 * length, 16, 12), look);
    dot.position.copy(b);
    this.around.add(dot);
    const corners = [[b, 1], [b, -1], [a, -1], [a, 1]].flatMap(([p, side]) => [p.x, p.y, (side * depth) / 2]);
    const plane = new THREE.BufferGeometry();
    plane.setAttribute("position", new THREE.BufferAttribute(new Float32Array(corners), 3));
    plane.setIndex([0, 1, 2, 0, 2, 3]);
    const veil = new THREE.MeshBasicMaterial({ color: colour, transparent: true, opacity: 0.13, side: THREE.DoubleSide, depthWrite: false });
    const sheet = new THREE.Mesh(plane, veil);
    this.around.add(sheet);
    this.inTheWay.things.push(sheet);
  }

  label(text, at, where) {
    const element = document.createElement("span");
    element.className = `label ${where}`;
    element.textContent = text;
    element.setAttribute("aria-hidden", "true");
    this.canvas.after(element);
    this.labels.push({ element, at: new THREE.Vector3(...at) });
  }

  /** Background and bed as the page's colour scheme has them. */
  paintScheme() {
    const style = getComputedStyle(this.holder);
    this.renderer.setClearColor(style.getPropertyValue("--stage").trim());
    const paint = (thing, name) => thing.material.color.set(style.getPropertyValue(name).trim());
    paint(this.bed, "--bed");
    for (const jaw of this.jaws) {
      paint(jaw.children[0], "--stem");
      paint(jaw.children[1], "--pad");
    }
  }

  /** Put another flap between the jaws; what was there stays with whoever has it. */
  put(flap) {
    if (this.flap) this.world.remove(this.flap.group);
    this.flap = flap;
    this.world.add(flap.group);
  }

  show(time, how) {
    this.flap.seeThrough(how.through);
    this.flap.show(time, how);
    const [x1, y1, x2, y2] = this.flap.jawsAt(time);
    this.jaws.forEach((jaw, k) => {
      jaw.position.set(k ? x2 : x1, k ? y2 : y1, 0);
      jaw.rotation.z = Math.atan2(x1 - x2, y2 - y1);
    });
  }

  /** "corner", "side" or "camera": from where to look. All of `points` is then in the picture, as large as it
   * goes. */
  lookFrom(where, points) {
    const { target, camera } = this.scene;
    const way = new THREE.Vector3(-0.42, 0.34, 1);
    if (where === "side") way.set(0, 0.001, 1);
    if (where === "camera") way.set(camera[0] - target[0], camera[1] - target[1], 0);
    way.normalize();
    const right = new THREE.Vector3(0, 1, 0).cross(way).normalize();
    const up = way.clone().cross(right);
    const tall = Math.tan((FIELD_OF_VIEW * Math.PI) / 360) * FILLED;
    const wide = tall * this.camera.aspect;
    // where lines through the points, as steep as the picture's borders, meet the axes: for each pair of borders
    const seen = points.map(([x, y, z]) => new THREE.Vector3(x, y, z)).map((p) => [p.dot(right), p.dot(up), p.dot(way)]);
    const [x, farX] = fitted(seen.map((p) => p[0]), seen.map((p) => p[2]), wide);
    const [y, farY] = fitted(seen.map((p) => p[1]), seen.map((p) => p[2]), tall);
    const middle = right.multiplyScalar(x).addScaledVector(up, y);
    const deep = seen.reduce((sum, p) => sum + p[2], 0) / seen.length;
    const far = Math.max(farX, farY);
    this.controls.target.copy(middle).addScaledVector(way, deep);
    this.camera.position.copy(middle).addScaledVector(way, far);
    this.camera.near = far / 50;
    this.camera.far = far * 50;
    this.camera.updateProjectionMatrix();
    this.controls.update();
  }

  /** Places that should be in the picture: what stands around, and the flap at all times. */
  places(where) {
    const { length, height, depth, target, sight } = this.scene;
    const half = depth / 2;
    const close = where === "camera"; // there what lies near B matters, and what lies nearer would only fill the picture
    const near = close ? -0.55 * length : -length;
    const places = [[...(close ? target : sight), 0], [0.14 * length, 0, half], [0.14 * length, height, -half], [near, 0, half], [near, 0, -half]];
    if (this.flap && !close) {
      const { low, size } = this.flap.data;
      for (const corner of [0, 1, 2, 3]) {
        places.push([low[0] + size[0] * (corner & 1), low[1] + size[1] * (corner >> 1), 0]);
      }
    }
    return places;
  }

  /** Look from where another view does. */
  lookAs(other) {
    this.camera.position.copy(other.camera.position);
    this.camera.near = other.camera.near;
    this.camera.far = other.camera.far;
    this.camera.updateProjectionMatrix();
    this.controls.target.copy(other.controls.target);
    this.controls.update();
  }

  /** Turn about the upright axis and lift, rad; and come nearer by a factor. */
  orbit(turn, lift, nearer = 1) {
    const off = this.camera.position.clone().sub(this.controls.target);
    const far = off.length();
    const upright = Math.min(Math.PI - 0.01, Math.max(0.01, Math.acos(off.y / far) - lift));
    const around = Math.atan2(off.x, off.z) + turn;
    off.set(Math.sin(upright) * Math.sin(around), Math.cos(upright), Math.sin(upright) * Math.cos(around));
    this.camera.position.copy(this.controls.target).addScaledVector(off, far / nearer);
    this.controls.update();
  }

  fit() {
    const { clientWidth, clientHeight } = this.canvas;
    if (!clientWidth) return;
    this.renderer.setSize(clientWidth, clientHeight, false);
    this.camera.aspect = clientWidth / clientHeight;
    this.camera.updateProjectionMatrix();
  }

  render() {
    // who looks along the line of sight wants to see what the camera sees
    const along = this.camera.position.clone().sub(this.controls.target).normalize().dot(this.inTheWay.way) > 0.97;
    for (const thing of this.inTheWay.things) thing.visible = !along;
    this.renderer.render(this.world, this.camera);
    const { clientWidth, clientHeight } = this.canvas;
    const at = new THREE.Vector3();
    for (const label of this.labels) {
      at.copy(label.at).project(this.camera);
      label.element.hidden = along || Math.abs(at.x) > 1 || Math.abs(at.y) > 1 || at.z > 1;
      label.element.style.left = `${((at.x + 1) / 2) * clientWidth}px`;
      label.element.style.top = `${((1 - at.y) / 2) * clientHeight}px`;
    }
  }
}

/** A convex outline [[x, y], ...] drawn out over a depth; side -1: upside down. */
function drawnOut(outline, side, depth) {
  const points = outline.map(([x, y]) => [x, side * y]);
  const out = [];
  const z = depth / 2;
  for (let k = 1; k + 1 < points.length; k++) {
    for (const end of [z, -z]) for (const p of [points[0], points[k], points[k + 1]]) out.push(...p, end);
  }
  points.forEach((p, k) => {
    const q = points[(k + 1) % points.length];
    out.push(...p, -z, ...q, -z, ...q, z, ...p, -z, ...q, z, ...p, z);
  });
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(new Float32Array(out), 3));
  geometry.computeVertexNormals();
  return geometry;
}
