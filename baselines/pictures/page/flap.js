// The flap in three dimensions: its surface and its veins, moved to any time.

/** Outward normals of indexed triangles, written into `normals`. */
function turnNormals(positions, index, normals) {
  normals.fill(0);
  for (let i = 0; i < index.length; i += 3) {
    const a = 3 * index[i];
    const b = 3 * index[i + 1];
    const c = 3 * index[i + 2];
    const ux = positions[b] - positions[a], uy = positions[b + 1] - positions[a + 1], uz = positions[b + 2] - positions[a + 2];
    const vx = positions[c] - positions[a], vy = positions[c + 1] - positions[a + 1], vz = positions[c + 2] - positions[a + 2];
    const nx = uy * vz - uz * vy, ny = uz * vx - ux * vz, nz = ux * vy - uy * vx;
    for (const k of [a, b, c]) {
      normals[k] += nx;
      normals[k + 1] += ny;
      normals[k + 2] += nz;
    }
  }
  for (let k = 0; k < normals.length; k += 3) {
    const long = Math.hypot(normals[k], normals[k + 1], normals[k + 2]) || 1;
    normals[k] /= long;
    normals[k + 1] /= long;
    normals[k + 2] /= long;
  }
}

/** Indexed triangles whose vertices move: `positions` is written by whoever owns it, then `update`. */
class Sheet {
  constructor(count, index, material) {
    this.index = index;
    this.geometry = new THREE.BufferGeometry();
    for (const name of ["position", "normal", "color"]) {
      const attribute = new THREE.BufferAttribute(new Float32Array(3 * count), 3);
      attribute.setUsage(THREE.DynamicDrawUsage);
      this.geometry.setAttribute(name, attribute);
    }
    this.geometry.setIndex(new THREE.BufferAttribute(index, 1));
    this.mesh = new THREE.Mesh(this.geometry, material);
    this.mesh.frustumCulled = false;
  }
  get positions() { return this.geometry.attributes.position.array; }
  get colours() { return this.geometry.attributes.color.array; }
  update() {
    turnNormals(this.positions, this.index, this.geometry.attributes.normal.array);
    for (const name of ["position", "normal", "color"]) this.geometry.attributes[name].needsUpdate = true;
  }
}

/** Lines between pairs of points that move. */
function movingLines(count, colour) {
  const geometry = new THREE.BufferGeometry();
  const attribute = new THREE.BufferAttribute(new Float32Array(3 * count), 3);
  attribute.setUsage(THREE.DynamicDrawUsage);
  geometry.setAttribute("position", attribute);
  const lines = new THREE.LineSegments(geometry, new THREE.LineBasicMaterial({ color: colour }));
  lines.frustumCulled = false;
  return lines;
}

class Flap {
  /** What a motion's data hold, ready to be moved. */
  static async of(data, palette, strains) {
    const names = ["nodes", "sides", "faces", "inVein", "skin", "walls", "end", "inner", "strain"];
    const arrays = await Promise.all(names.map((name) => unpack(data[name])));
    return new Flap(data, Object.fromEntries(names.map((name, i) => [name, arrays[i]])), palette, strains);
  }

  constructor(data, arrays, palette, strains) {
    Object.assign(this, arrays);
    this.data = data;
    this.strains = strains;
    this.vertexCount = this.nodes.length;
    this.nodeCount = data.end.shape[1];
    [, this.innerLevels, this.sideCount] = data.inner.shape;
    this.sideOf = new Int32Array(this.nodeCount).fill(-1);
    this.sides.forEach((node, k) => { this.sideOf[node] = k; });
    this.endNow = new Float32Array(3 * this.nodeCount);
    this.innerNow = new Float32Array(3 * this.sideCount * this.innerLevels);
    this.strainNow = new Float32Array(this.vertexCount);
    this.plain = { tissue: new THREE.Color(palette.TISSUE), vein: new THREE.Color(palette.VEIN) };
    const look = { vertexColors: true, polygonOffset: true, polygonOffsetFactor: 1, polygonOffsetUnits: 1 };
    this.tissueLook = new THREE.MeshLambertMaterial(look);
    this.veinLook = new THREE.MeshLambertMaterial({ ...look, polygonOffsetFactor: 0.5, polygonOffsetUnits: 0.5 });
    this.group = new THREE.Group();
    this.shape(0);
    this.makeEnds();
    this.makeSides();
    this.outline = movingLines(4 * this.skin.length / 2 + this.ridges.length * 2 * (this.rowCount - 1), palette.INK);
    this.veinLines = movingLines(4 * this.walls.length / 2, palette.VEIN_EDGE);
    this.group.add(this.outline, this.veinLines);
    for (const jaw of [0, 2]) { // the way that each jaw goes
      const way = new THREE.BufferGeometry();
      const places = data.jaws.flatMap((at) => [at[jaw], at[jaw + 1], 0]);
      way.setAttribute("position", new THREE.BufferAttribute(new Float32Array(places), 3));
      this.group.add(new THREE.Line(way, new THREE.LineBasicMaterial({ color: palette.VALUE })));
    }
  }

  /** Faces that close both ends of the depth: tissue's and the veins'. */
  makeEnds() {
    const { faces, inVein, vertexCount } = this;
    const found = { tissue: [], vein: [] };
    for (let f = 0; f < inVein.length; f++) {
      found[inVein[f] ? "vein" : "tissue"].push(faces[3 * f], faces[3 * f + 1], faces[3 * f + 2]);
    }
    for (const [begin, count] of this.data.rings) {
      const points = [];
      for (let k = begin; k < begin + count; k++) {
        const at = 3 * this.nodes[k];
        points.push(new THREE.Vector2(this.endNow[at], this.endNow[at + 1]));
      }
      for (const face of THREE.ShapeUtils.triangulateShape(points, [])) found.vein.push(...face.map((k) => begin + k));
    }
    this.ends = {};
    for (const kind of ["tissue", "vein"]) {
      const front = found[kind];
      const index = new Uint32Array(2 * front.length);
      index.set(front);
      for (let i = 0; i < front.length; i += 3) { // the far end looks the other way
        index.set([front[i], front[i + 2], front[i + 1]].map((v) => v + vertexCount), front.length + i);
      }
      this.ends[kind] = new Sheet(2 * vertexCount, index, kind === "vein" ? this.veinLook : this.tissueLook);
      this.group.add(this.ends[kind].mesh);
    }
  }

  /** Sides drawn out over the depth, of the flap and of its veins. At the flap's corners shading has an edge. */
  makeSides() {
    const { plane, along } = this.data.rows;
    this.rows = [];
    for (let r = plane.length - 1; r > 0; r--) this.rows.push({ plane: plane[r], along: along[r], side: -1 });
    for (let r = 0; r < plane.length; r++) this.rows.push({ plane: plane[r], along: along[r], side: 1 });
    this.rowCount = this.rows.length;
    this.strips = {};
    for (const [kind, edges] of [["tissue", this.skin], ["vein", this.walls]]) {
      const place = new Map();
      const owners = [];
      const ends = [];
      for (let e = 0; e < edges.length; e += 2) {
        const [a, b] = [edges[e], edges[e + 1]];
        const [dx, dy] = [0, 1].map((k) => this.endNow[3 * this.nodes[b] + k] - this.endNow[3 * this.nodes[a] + k]);
        const facing = kind === "vein" ? 0 : Math.abs(dx) > Math.abs(dy) ? (dx > 0 ? 0 : 1) : dy > 0 ? 2 : 3;
        for (const v of [a, b]) {
          const key = 4 * v + facing;
          if (!place.has(key)) {
            place.set(key, owners.length);
            owners.push(v);
          }
          ends.push(place.get(key));
        }
      }
      if (kind === "tissue") this.ridges = this.cornersOf(place);
      const n = owners.length;
      const index = [];
      for (let e = 0; e < ends.length; e += 2) {
        for (let r = 0; r + 1 < this.rowCount; r++) {
          const [a, b] = [ends[e] + r * n, ends[e + 1] + r * n];
          index.push(a, b, b + n, a, b + n, a + n);
        }
      }
      const look = kind === "vein" ? this.veinLook : this.tissueLook;
      const sheet = new Sheet(n * this.rowCount, Uint32Array.from(index), look);
      this.strips[kind] = { sheet, owners };
      this.group.add(sheet.mesh);
    }
  }

  /** Places in the strip, one for each vertex where two of the flap's sides meet. */
  cornersOf(place) {
    const seen = new Map();
    const found = new Set();
    for (const [key, at] of place) {
      const v = key >> 2;
      if (seen.has(v)) found.add(seen.get(v));
      else seen.set(v, at);
    }
    return [...found];
  }

  /** Where nodes are and how strained vertices are at a time, between the two nearest frames. */
  shape(time) {
    const { low, size, frameTime } = this.data;
    const { before, after, part } = between(frameTime, time);
    const into = (out, from, row) => {
      const [a, b] = [before * row, after * row];
      for (let i = 0; i < row; i++) {
        const whole = from[a + i] + (from[b + i] - from[a + i]) * part + 32768;
        out[i] = low[i % 3] + (whole / 65535) * size[i % 3];
      }
    };
    into(this.endNow, this.end, 3 * this.nodeCount);
    into(this.innerNow, this.inner, 3 * this.sideCount * this.innerLevels);
    const [a, b] = [before * this.vertexCount, after * this.vertexCount];
    for (let v = 0; v < this.vertexCount; v++) {
      this.strainNow[v] = ((this.strain[a + v] + (this.strain[b + v] - this.strain[a + v]) * part) / 255) * this.data.strainTop;
    }
  }

  /** Move to a time. how.colour: "flap", "veins" or "off"; how.top: strain of the darkest colour. */
  show(time, how) {
    this.shape(time);
    for (const kind of ["tissue", "vein"]) {
      this.placeEnds(kind);
      this.placeSides(kind);
      const strained = how.colour === "flap" || (how.colour === "veins" && kind === "vein");
      this.paint(this.ends[kind].colours, null, 2, kind, strained ? how.top : 0);
      this.paint(this.strips[kind].sheet.colours, this.strips[kind].owners, this.rowCount, kind, strained ? how.top : 0);
      this.ends[kind].update();
      this.strips[kind].sheet.update();
    }
    this.placeLines();
  }

  /** Colour the vertices `owners`, null: all of them in turn, and `copies` of them: by strain up to the top
   * of the scale, 0: as "tissue" or "vein" is. */
  paint(colours, owners, copies, kind, top) {
    const count = owners ? owners.length : this.vertexCount;
    const { light } = this.strains;
    let { r, g, b } = this.plain[kind];
    for (let k = 0; k < count; k++) {
      if (top > 0) {
        const at = 3 * Math.min(255, Math.floor((256 * this.strainNow[owners ? owners[k] : k]) / top));
        r = light[at];
        g = light[at + 1];
        b = light[at + 2];
      }
      for (let c = k; c < copies * count; c += count) {
        colours[3 * c] = r;
        colours[3 * c + 1] = g;
        colours[3 * c + 2] = b;
      }
    }
  }

  placeEnds(kind) {
    const { positions } = this.ends[kind];
    const far = 3 * this.vertexCount;
    for (let v = 0; v < this.vertexCount; v++) {
      const from = 3 * this.nodes[v];
      positions[3 * v] = positions[far + 3 * v] = this.endNow[from];
      positions[3 * v + 1] = positions[far + 3 * v + 1] = this.endNow[from + 1];
      positions[3 * v + 2] = this.endNow[from + 2];
      positions[far + 3 * v + 2] = -this.endNow[from + 2];
    }
  }

  placeSides(kind) {
    const { sheet, owners } = this.strips[kind];
    const { positions } = sheet;
    const n = owners.length;
    const inner = 3 * this.sideCount;
    for (let k = 0; k < n; k++) {
      const node = this.nodes[owners[k]];
      const [end, side] = [3 * node, 3 * this.sideOf[node]];
      for (let r = 0; r < this.rowCount; r++) {
        const row = this.rows[r];
        let x = 0, y = 0, z = 0;
        for (let l = 0; l < row.plane.length; l++) {
          const outer = l === this.innerLevels;
          const from = outer ? this.endNow : this.innerNow;
          const at = outer ? end : l * inner + side;
          x += row.plane[l] * from[at];
          y += row.plane[l] * from[at + 1];
          z += row.along[l] * from[at + 2];
        }
        const to = 3 * (r * n + k);
        positions[to] = x;
        positions[to + 1] = y;
        positions[to + 2] = row.side * z;
      }
    }
  }

  /** The edges of both ends, the flap's long edges, and the veins' outlines. */
  placeLines() {
    for (const [lines, edges] of [[this.outline, this.skin], [this.veinLines, this.walls]]) {
      const out = lines.geometry.attributes.position.array;
      let to = 0;
      for (const side of [1, -1]) {
        for (const v of edges) {
          const from = 3 * this.nodes[v];
          out[to++] = this.endNow[from];
          out[to++] = this.endNow[from + 1];
          out[to++] = side * this.endNow[from + 2];
        }
      }
      if (edges === this.skin) {
        const { sheet, owners } = this.strips.tissue;
        for (const k of this.ridges) {
          for (let r = 0; r + 1 < this.rowCount; r++) {
            for (const row of [r, r + 1]) {
              const from = 3 * (row * owners.length + k);
              for (let c = 0; c < 3; c++) out[to++] = sheet.positions[from + c];
            }
          }
        }
      }
      lines.geometry.attributes.position.needsUpdate = true;
    }
  }

  /** Let veins be seen through the tissue, or not. */
  seeThrough(through) {
    if (this.through === through) return;
    this.through = through;
    Object.assign(this.tissueLook, { transparent: through, opacity: through ? 0.3 : 1, depthWrite: !through });
    this.tissueLook.needsUpdate = true;
  }

  /** The jaws' places at a time, mm. */
  jawsAt(time) {
    const { before, after, part } = between(this.data.time, time);
    return this.data.jaws[before].map((x, k) => x + (this.data.jaws[after][k] - x) * part);
  }
}
