// Conversions of Gaussian files by programs of npm, for splat_converters.py. Reads a list of jobs
// [program, source, target] and prints a list of errors, "" where there was none. It is run with
// the folder as working directory that install_splat_tools.sh filled.
import fs from "fs";
import { Readable } from "stream";
import { loadCompressedPly, loadPly, loadSpz, serializeCompressedPly, serializePly, serializeSpz } from "spz-js";

const slice = (bytes) => bytes.buffer.slice(bytes.byteOffset, bytes.byteOffset + bytes.byteLength);
const stream = (path) => Readable.toWeb(fs.createReadStream(path));
const load = (path) => (path.endsWith(".compressed.ply") ? loadCompressedPly : loadPly)(stream(path));

async function convertBySpzJs(source, target) {
  const cloud = source.endsWith(".spz") ? await loadSpz(fs.readFileSync(source)) : await load(source);
  if (target.endsWith(".spz")) return serializeSpz(cloud);
  return (target.endsWith(".compressed.ply") ? serializeCompressedPly : serializePly)(cloud);
}

// Niantic's own C++, compiled by Adobe; it has no files .ply, which spz-js reads and writes here. A
// comment of the .ply stands for the argument "antialiased"
const COMMENT = "comment SplatRenderMode: mip\n";

function withComment(data, antialiased) {
  const bytes = Buffer.from(data);
  const at = bytes.indexOf("element vertex");
  const comment = Buffer.from(antialiased ? COMMENT : "");
  return Buffer.concat([bytes.subarray(0, at), comment, bytes.subarray(at)]);
}

async function convertByAdobe(source, target) {
  const spz = await (await import("@adobe/spz")).default({ print: () => {}, printErr: () => {} });
  const from = spz.CoordinateSystem.UNSPECIFIED; // the default: nothing is turned
  if (source.endsWith(".spz")) {
    const cloud = spz.loadSpzFromBuffer(fs.readFileSync(source), { to: from });
    return withComment(serializePly(cloud), cloud.antialiased);
  }
  const antialiased = fs.readFileSync(source).subarray(0, 200).includes(COMMENT);
  const cloud = { ...(await load(source)), antialiased, extensions: [] };
  for (const key of ["positions", "scales", "rotations", "alphas", "colors", "sh"]) {
    cloud[key] = Float32Array.from(cloud[key]);
  }
  const options = { version: target.endsWith("-3.spz") ? 3 : 4, from, sh1Bits: 8, shRestBits: 8 };
  return spz.saveSpzToBuffer(cloud, options);
}

async function convertByGaussianSplats3D(source, target) {
  const THREE = await import("three");
  const { PlyParser, SplatBufferGenerator } = await import("@mkkellogg/gaussian-splats-3d");
  const level = Number(/-(\d)\.ksplat$/.exec(target)[1]);
  const log = console.log;
  console.log = () => {}; // it prints its sizes
  try {
    const splats = PlyParser.parseToUncompressedSplatArray(slice(fs.readFileSync(source)), 2);
    const center = new THREE.Vector3();
    const generator = SplatBufferGenerator.getStandardGenerator(1, level, 0, center);
    return Buffer.from(generator.generateFromUncompressedSplatArray(splats).bufferData);
  } finally {
    console.log = log;
  }
}

// the arrays that three.js gives to its renderer: bytes of colors, covariances in float32
async function convertByThree(source) {
  const { GLTFLoader } = await import("three/addons/loaders/GLTFLoader.js");
  const { GLTFGaussianSplatLoaderExtension } = await import(
    "three/addons/loaders/GLTFGaussianSplatLoaderExtension.js"
  );
  const loader = new GLTFLoader().register((parser) => new GLTFGaussianSplatLoaderExtension(parser));
  const { scene } = await loader.parseAsync(slice(fs.readFileSync(source)), "");
  const geometry = scene.children[0].splatGeometry;
  const bytes = (array) => Array.from(new Uint8Array(array.buffer, array.byteOffset, array.byteLength));
  const found = {};
  for (const [name, { array }] of Object.entries(geometry.attributes)) {
    found[name] = array instanceof Float32Array ? Array.from(array) : bytes(array);
  }
  return JSON.stringify(found);
}

async function convertByValidator(source) {
  const { default: validator } = await import("gltf-validator");
  return JSON.stringify(await validator.validateBytes(new Uint8Array(fs.readFileSync(source))));
}

const PROGRAMS = {
  "spz-js": convertBySpzJs,
  "@adobe/spz": convertByAdobe,
  "@mkkellogg/gaussian-splats-3d": convertByGaussianSplats3D,
  three: convertByThree,
  "gltf-validator": convertByValidator,
};

const errors = [];
for (const [program, source, target] of JSON.parse(fs.readFileSync(process.argv[2]))) {
  try {
    const data = await PROGRAMS[program](source, target);
    fs.writeFileSync(target, data instanceof ArrayBuffer ? Buffer.from(data) : data);
    errors.push("");
  } catch (error) {
    errors.push(`${error?.message ?? error}` || "an error without words");
  }
}
console.log(JSON.stringify(errors));
