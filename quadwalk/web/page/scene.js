/** The picture: the robot as MuJoCo has it, its ground, light and camera. */

import * as THREE from "three";

/** @typedef {import("./simulation.js").Simulation} Simulation */

// MuJoCo's mjtGeom
const [SPHERE, CAPSULE, ELLIPSOID, CYLINDER, BOX, MESH] = [2, 3, 4, 5, 6, 7];
const SKY = 0xdfe8f0;
const GRAY = 0xf4f7fa; // of a rival
const FLOOR = 400; // m, the side of the flat floor that is drawn
const PIECE = 40; // cells, the side of a piece of uneven ground
const SIGHT = 60; // m, where the flat floor fades
const ROUGH_SIGHT = 18; // m, where uneven ground does
const SLOW = 0.05; // s between pictures, beyond which they get fewer pixels
const COARSEST = 0.4; // share of the screen's pixels to a side below which they get no fewer
const TRAIL = 600; // points
const ARROWS = 12;
const ARROW_SCALE = 0.0015; // m per N
const SPRING = 250; // N per m, of a drag
const ASIDE = 0.8; // m, from a robot to its rival
/** @type {Record<string, number>} how far each camera is turned about the robot, rad */
const CAMERAS = { behind: 0, side: Math.PI / 2, free: 0.7 };

/** Draw a floor's square of 2 m: two fields of 1 m, each with an edge. */
function drawSquare() {
  const canvas = document.createElement("canvas");
  canvas.width = canvas.height = 256;
  const context = /** @type {CanvasRenderingContext2D} */ (canvas.getContext("2d"));
  const colors = ["#98a2ad", "#a5aeb8"];
  for (const [x, y] of [0, 1].flatMap((i) => [0, 1].map((j) => [i, j]))) {
    context.fillStyle = colors[(x + y) % 2];
    context.fillRect(128 * x, 128 * y, 128, 128);
    context.strokeStyle = "#c3cad1";
    context.lineWidth = 2;
    context.strokeRect(128 * x, 128 * y, 128, 128);
  }
  const texture = new THREE.CanvasTexture(canvas);
  texture.wrapS = texture.wrapT = THREE.RepeatWrapping;
  texture.colorSpace = THREE.SRGBColorSpace;
  texture.anisotropy = 4;
  return texture;
}

/**
 * Return the shape of a geom about its own frame, z up.
 * @param {any} model
 * @param {number} geom
 */
function makeShape(model, geom) {
  const [a, b, c] = model.geom_size.subarray(3 * geom, 3 * geom + 3);
  switch (model.geom_type[geom]) {
    case SPHERE:
      return new THREE.SphereGeometry(a, 20, 14);
    case CAPSULE:
      return new THREE.CapsuleGeometry(a, 2 * b, 6, 16).rotateX(Math.PI / 2);
    case ELLIPSOID:
      return new THREE.SphereGeometry(1, 20, 14).scale(a, b, c);
    case CYLINDER:
      return new THREE.CylinderGeometry(a, a, 2 * b, 20).rotateX(Math.PI / 2);
    case BOX:
      return new THREE.BoxGeometry(2 * a, 2 * b, 2 * c);
    case MESH:
      return makeMesh(model, model.geom_dataid[geom]);
    default:
      return null;
  }
}

/**
 * Return a mesh of the model.
 * @param {any} model
 * @param {number} mesh
 */
function makeMesh(model, mesh) {
  const vertex = 3 * model.mesh_vertadr[mesh];
  const face = 3 * model.mesh_faceadr[mesh];
  const vertices = model.mesh_vert.slice(vertex, vertex + 3 * model.mesh_vertnum[mesh]);
  const faces = model.mesh_face.slice(face, face + 3 * model.mesh_facenum[mesh]);
  const geometry = new THREE.BufferGeometry();
  geometry.setAttribute("position", new THREE.BufferAttribute(vertices, 3));
  geometry.setIndex(new THREE.BufferAttribute(new Uint32Array(faces), 1));
  return geometry;
}

/**
 * Return the ground's surface in square pieces, colored by height.
 * @param {import("./terrain.js").Terrain} terrain
 */
function makeGround(terrain) {
  const { rows, columns } = terrain.file;
  const material = new THREE.MeshLambertMaterial({ vertexColors: true, flatShading: true });
  const pieces = [];
  for (let row = 0; row < rows - 1; row += PIECE) {
    for (let column = 0; column < columns - 1; column += PIECE) {
      pieces.push(new THREE.Mesh(makePiece(terrain, row, column), material));
    }
  }
  return pieces;
}

/**
 * Return one piece of the ground, from this row and column on.
 * @param {import("./terrain.js").Terrain} terrain
 * @param {number} top
 * @param {number} left
 */
function makePiece(terrain, top, left) {
  const { rows, columns, cell, origin, low } = terrain.file;
  const height = Math.min(PIECE, rows - 1 - top);
  const width = Math.min(PIECE, columns - 1 - left);
  const geometry = new THREE.PlaneGeometry(1, 1, width, height);
  const positions = geometry.attributes.position;
  const colors = new THREE.BufferAttribute(new Float32Array(3 * positions.count), 3);
  const color = new THREE.Color();
  const meter = Math.round(1 / cell);
  for (let node = 0; node < positions.count; node++) {
    // A plane's rows go down, so that its squares are cut as MuJoCo cuts them.
    const row = top + height - Math.floor(node / (width + 1));
    const column = left + (node % (width + 1));
    const level = terrain.heights[row * columns + column];
    positions.setXYZ(node, origin[0] + column * cell, origin[1] + row * cell, level);
    const share = (level - low) / terrain.range;
    color.setHSL(0.58 - 0.5 * share, 0.25, 0.5 + 0.15 * share);
    if (row % meter === 0 || column % meter === 0) color.multiplyScalar(0.88);
    colors.setXYZ(node, color.r, color.g, color.b);
  }
  geometry.setAttribute("color", colors);
  return geometry;
}

/** The scene of one page. */
export class Scene {
  /** @param {HTMLCanvasElement} canvas */
  constructor(canvas) {
    this.canvas = canvas;
    this.renderer = new THREE.WebGLRenderer({ canvas, antialias: true });
    this.renderer.shadowMap.enabled = true;
    this.scene = new THREE.Scene();
    this.scene.background = new THREE.Color(SKY);
    this.camera = new THREE.PerspectiveCamera(45, 1, 0.05, SIGHT);
    this.camera.up.set(0, 0, 1);
    this.sun = this.addLights();
    this.robot = new THREE.Group();
    this.scene.add(this.robot);
    /** @type {{mesh: THREE.Mesh, geom: number, robot: Simulation}[]} */
    this.parts = [];
    /** @type {Simulation | null} what is shown beside the robot, in gray */
    this.rival = null;
    this.mode = "behind";
    /** Where the camera is: its turn and height about the robot, rad, and its distance, m. */
    this.orbit = { turn: 0, lift: 0.3, distance: 2.4 };
    this.heading = 0;
    this.target = new THREE.Vector3(0, 0, 0.3);
    this.trail = this.makeTrail();
    /** @type {THREE.Vector3[]} */
    this.path = [];
    this.arrows = this.makeArrows();
    this.showsForces = true;
    this.showsTrail = true;
    this.raycaster = new THREE.Raycaster();
    this.sharpness = 1; // share of the screen's pixels to a side
    this.pause = 0; // s between pictures, on average
    this.listen();
  }

  addLights() {
    const sun = new THREE.DirectionalLight(0xffffff, 2);
    sun.castShadow = true;
    sun.shadow.mapSize.set(1024, 1024);
    sun.shadow.bias = -0.0005;
    const box = sun.shadow.camera;
    [box.left, box.right, box.top, box.bottom] = [-1.5, 1.5, 1.5, -1.5];
    [box.near, box.far] = [0.5, 12];
    this.scene.add(new THREE.HemisphereLight(0xffffff, 0x8890a0, 1.6), sun, sun.target);
    return sun;
  }

  makeTrail() {
    const points = Array(TRAIL).fill(new THREE.Vector3());
    const geometry = new THREE.BufferGeometry().setFromPoints(points);
    const line = new THREE.Line(geometry, new THREE.LineBasicMaterial({ color: 0x1c6dd0 }));
    line.frustumCulled = false;
    this.scene.add(line);
    return line;
  }

  makeArrows() {
    return Array.from({ length: ARROWS }, () => {
      const up = new THREE.Vector3(0, 0, 1);
      const arrow = new THREE.ArrowHelper(up, new THREE.Vector3(), 0.1, 0xe0452f, 0.05, 0.03);
      arrow.visible = false;
      this.scene.add(arrow);
      return arrow;
    });
  }

  /**
   * Show another robot.
   * @param {Simulation} simulation
   */
  setSimulation(simulation) {
    this.simulation = simulation;
    for (const child of [...this.robot.children]) {
      this.robot.remove(child);
      /** @type {THREE.Mesh} */ (child).geometry?.dispose();
    }
    this.parts = [];
    this.path = [];
    this.floor = null;
    const { terrain } = simulation;
    const sight = terrain ? ROUGH_SIGHT : SIGHT;
    this.scene.fog = new THREE.Fog(SKY, sight / 4, sight);
    this.camera.far = sight + 1; // pieces of the ground beyond it are not drawn
    this.resize();
    this.orbit.lift = terrain ? 0.6 : 0.3; // over the steps behind it
    for (const piece of terrain ? makeGround(terrain) : [this.makeFloor()]) {
      piece.receiveShadow = true;
      this.robot.add(piece);
    }
    this.addParts(simulation);
  }

  /**
   * Show a second robot beside the first; null takes it away.
   * @param {Simulation | null} rival
   */
  setRival(rival) {
    for (const { mesh, robot } of this.parts) if (robot === this.rival) this.robot.remove(mesh);
    this.parts = this.parts.filter(({ robot }) => robot !== this.rival);
    this.rival = rival;
    if (rival) this.addParts(rival);
  }

  /** @param {Simulation} robot */
  addParts(robot) {
    const { model } = robot;
    const hasVisuals = Array.from(model.geom_group).some((group) => group === 2);
    for (let geom = 0; geom < model.ngeom; geom++) {
      const isShown = model.geom_group[geom] === 2 || !hasVisuals;
      if (isShown && geom !== 0) this.addPart(robot, geom);
    }
  }

  makeFloor() {
    const texture = drawSquare();
    texture.repeat.set(FLOOR / 2, FLOOR / 2);
    const material = new THREE.MeshLambertMaterial({ map: texture });
    this.floor = new THREE.Mesh(new THREE.PlaneGeometry(FLOOR, FLOOR), material);
    return this.floor;
  }

  /** @param {Simulation} robot @param {number} geom */
  addPart(robot, geom) {
    const { model } = robot;
    const shape = makeShape(model, geom);
    if (!shape) return;
    const material = model.geom_matid[geom];
    const colors = material >= 0 ? model.mat_rgba : model.geom_rgba;
    const at = 4 * (material >= 0 ? material : geom);
    const [red, green, blue, opacity] = colors.subarray(at, at + 4);
    const flatShading = model.geom_type[geom] === MESH;
    const look = new THREE.MeshStandardMaterial({ roughness: 0.6, metalness: 0.1, flatShading });
    look.color.setRGB(red, green, blue, THREE.SRGBColorSpace);
    if (robot === this.rival) look.color.lerp(new THREE.Color(GRAY), 0.85);
    if (opacity < 1) Object.assign(look, { transparent: true, opacity });
    const mesh = new THREE.Mesh(shape, look);
    mesh.castShadow = mesh.receiveShadow = true;
    mesh.matrixAutoUpdate = false;
    this.robot.add(mesh);
    this.parts.push({ mesh, geom, robot });
  }

  /** Hear drags, wheel and pinches on the picture. */
  listen() {
    /** @type {Map<number, {x: number, y: number}>} */
    const pointers = new Map();
    let pinch = 0;
    this.canvas.addEventListener("pointerdown", (event) => {
      this.canvas.setPointerCapture(event.pointerId);
      pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
      if (pointers.size === 1) this.startPull(event);
      else this.endPull();
    });
    this.canvas.addEventListener("pointermove", (event) => {
      const last = pointers.get(event.pointerId);
      if (!last) return;
      const [dx, dy] = [event.clientX - last.x, event.clientY - last.y];
      pointers.set(event.pointerId, { x: event.clientX, y: event.clientY });
      if (pointers.size === 2) {
        const [a, b] = [...pointers.values()];
        const width = Math.hypot(a.x - b.x, a.y - b.y);
        if (pinch) this.zoom(pinch / width);
        pinch = width;
      } else if (this.grip) this.movePull(event);
      else this.turn(dx, dy);
    });
    this.canvas.addEventListener("lostpointercapture", (event) => {
      pointers.delete(event.pointerId);
      pinch = 0;
      this.endPull();
    });
    this.canvas.addEventListener(
      "wheel",
      (event) => {
        event.preventDefault();
        this.zoom(Math.exp(0.001 * event.deltaY));
      },
      { passive: false },
    );
  }

  /** @param {number} dx pixels @param {number} dy pixels */
  turn(dx, dy) {
    this.orbit.turn -= 0.006 * dx;
    this.orbit.lift = Math.min(Math.max(this.orbit.lift + 0.004 * dy, 0.03), 1.5);
  }

  /** @param {number} factor */
  zoom(factor) {
    this.orbit.distance = Math.min(Math.max(this.orbit.distance * factor, 0.7), 25);
  }

  /** Choose the next camera; return its name. */
  nextCamera() {
    const modes = Object.keys(CAMERAS);
    this.mode = modes[(modes.indexOf(this.mode) + 1) % modes.length];
    this.orbit.turn = CAMERAS[this.mode];
    return this.mode;
  }

  /** @param {PointerEvent} event */
  aim(event) {
    const box = this.canvas.getBoundingClientRect();
    const x = (2 * (event.clientX - box.left)) / box.width - 1;
    const y = 1 - (2 * (event.clientY - box.top)) / box.height;
    this.raycaster.setFromCamera(new THREE.Vector2(x, y), this.camera);
  }

  /** @param {PointerEvent} event */
  startPull(event) {
    const { simulation } = this;
    if (!simulation) return;
    this.aim(event);
    const parts = this.parts.filter(({ robot }) => robot === simulation);
    const [hit] = this.raycaster.intersectObjects(parts.map((part) => part.mesh));
    if (!hit) return;
    const part = parts.find(({ mesh }) => mesh === hit.object);
    const body = simulation.model.geom_bodyid[/** @type {any} */ (part).geom];
    const at = hit.point.clone();
    const origin = new THREE.Vector3().fromArray(simulation.data.xpos, 3 * body);
    this.grip = { body, offset: at.clone().sub(origin), distance: hit.distance, goal: at };
  }

  /** @param {PointerEvent} event */
  movePull(event) {
    if (!this.grip) return;
    this.aim(event);
    this.raycaster.ray.at(this.grip.distance, this.grip.goal);
  }

  endPull() {
    this.grip = null;
    if (this.simulation) this.simulation.pull = { body: 0, force: [0, 0, 0], torque: [0, 0, 0] };
  }

  updatePull() {
    const { grip, simulation } = this;
    if (!grip || !simulation) return;
    const { xpos, xipos } = simulation.data;
    const { body } = grip;
    const point = new THREE.Vector3().fromArray(xpos, 3 * body).add(grip.offset);
    const center = new THREE.Vector3().fromArray(xipos, 3 * body);
    const force = grip.goal.clone().sub(point).multiplyScalar(SPRING);
    const torque = point.sub(center).cross(force);
    simulation.pull = { body, force: force.toArray(), torque: torque.toArray() };
  }

  /**
   * Draw the present state.
   * @param {number} dt s on the wall since the last picture
   */
  draw(dt) {
    const { simulation } = this;
    if (!simulation) return;
    this.updatePull();
    const { qpos } = simulation.data;
    for (const { mesh, geom, robot } of this.parts) {
      const { geom_xpos: positions, geom_xmat: rotations } = robot.data;
      const aside = robot === this.rival ? this.aside : 0;
      const [p, r] = [3 * geom, 9 * geom];
      // prettier-ignore
      mesh.matrix.set(
        rotations[r], rotations[r + 1], rotations[r + 2], positions[p],
        rotations[r + 3], rotations[r + 4], rotations[r + 5], positions[p + 1] + aside,
        rotations[r + 6], rotations[r + 7], rotations[r + 8], positions[p + 2],
        0, 0, 0, 1,
      );
    }
    this.moveCamera(dt, qpos);
    this.drawTrail(qpos);
    this.drawForces(simulation.forces);
    this.renderer.render(this.scene, this.camera);
  }

  /** m along y from where a rival is to where it is drawn; on uneven ground it is in its place */
  get aside() {
    return this.simulation?.terrain ? 0 : ASIDE;
  }

  /** @param {number} dt @param {Float64Array} qpos */
  moveCamera(dt, qpos) {
    const { orbit, target, simulation } = this;
    const [x, y, z] = qpos;
    const ground = z - /** @type {Simulation} */ (simulation).height;
    const share = 1 - Math.exp(-8 * dt);
    const goal = new THREE.Vector3(x, y, ground + 0.3);
    let distance = orbit.distance;
    if (this.rival) {
      const [a, b] = this.rival.data.qpos;
      const other = new THREE.Vector3(a, b + this.aside, goal.z);
      distance += Math.min(goal.distanceTo(other), 20);
      goal.lerp(other, 0.5);
    }
    const jumps = goal.distanceTo(target) > 2;
    target.lerp(goal, jumps ? 1 : share);
    const heading = /** @type {Simulation} */ (simulation).heading;
    const away = Math.atan2(Math.sin(heading - this.heading), Math.cos(heading - this.heading));
    if (this.mode !== "free") this.heading += away * (1 - Math.exp(-3 * dt));
    const turn = orbit.turn + (this.mode === "free" ? 0 : this.heading);
    const flat = distance * Math.cos(orbit.lift);
    this.camera.position.set(
      target.x - flat * Math.cos(turn),
      target.y - flat * Math.sin(turn),
      target.z + distance * Math.sin(orbit.lift),
    );
    this.camera.lookAt(target);
    const { sun, floor } = this;
    sun.position.set(target.x + 1.5, target.y - 2, target.z + 5);
    sun.target.position.copy(target);
    // The floor goes with the robot by whole squares of its pattern, so that it has no end.
    floor?.position.set(2 * Math.round(target.x / 2), 2 * Math.round(target.y / 2), 0);
  }

  /** @param {Float64Array} qpos */
  drawTrail(qpos) {
    const { path } = this;
    const point = new THREE.Vector3(qpos[0], qpos[1], this.target.z - 0.29);
    const way = path.at(-1)?.distanceTo(point) ?? Infinity;
    if (way > 1) path.length = 0;
    if (way > 0.04) path.push(point);
    if (path.length > TRAIL) path.shift();
    this.trail.geometry.setFromPoints(path).setDrawRange(0, path.length);
    this.trail.visible = this.showsTrail;
  }

  /** @param {{point: number[], force: number[]}[]} forces */
  drawForces(forces) {
    this.arrows.forEach((arrow, k) => {
      const contact = forces[k];
      arrow.visible = Boolean(contact) && this.showsForces;
      if (!arrow.visible) return;
      const force = new THREE.Vector3().fromArray(contact.force);
      const length = Math.max(ARROW_SCALE * force.length(), 0.02);
      arrow.position.fromArray(contact.point);
      arrow.setDirection(force.normalize());
      arrow.setLength(length, Math.min(0.05, length / 2), 0.03);
    });
  }

  /**
   * Draw fewer pixels where pictures come slowly, as without a graphics card.
   * @param {number} dt s on the wall since the last picture
   */
  adapt(dt) {
    this.pause += 0.1 * (dt - this.pause);
    if (this.pause < SLOW || this.sharpness < COARSEST) return;
    this.pause = 0;
    this.sharpness *= 0.7;
    this.resize();
  }

  /** Draw every pixel, as for a film. */
  sharpen() {
    this.sharpness = 1;
    this.resize();
  }

  /** Fit the picture to its element. */
  resize() {
    const { clientWidth: width, clientHeight: height } = this.canvas;
    if (!width || !height) return;
    this.renderer.setPixelRatio(this.sharpness * Math.min(devicePixelRatio, 2));
    this.renderer.setSize(width, height, false);
    this.camera.aspect = width / height;
    this.camera.fov = width < height ? 70 : 45;
    this.camera.updateProjectionMatrix();
  }
}
