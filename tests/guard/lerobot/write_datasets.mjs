// Writes datasets in LeRobot's layout with parquet-wasm and hyparquet-writer, and their common content (expected.json).
// usage: write_datasets.mjs RUNTIME_DIR OUT_DIR
import * as fs from "fs";
import { createRequire } from "module";
import * as path from "path";
import { pathToFileURL } from "url";

const [runtime, out] = process.argv.slice(2);
const require = createRequire(pathToFileURL(path.join(path.resolve(runtime), "package.json")));
const arrow = require("apache-arrow");
const wasm = require("parquet-wasm/node");
const { parquetWriteBuffer } = await import(
  pathToFileURL(path.join(path.resolve(runtime), "node_modules/hyparquet-writer/src/index.js")));

// Points that go right along y = 0: 24 episodes of 18 to 22 frames, exact in 32 bits.
let lcg = 7;
const random = () => (lcg = (lcg * 1103515245 + 12345) % 2147483648) / 2147483648 - 0.5;
const frames = [];
const expected = [];
for (let episode = 0, index = 0; episode < 24; ++episode) {
  const length = 18 + (episode % 5);
  let x = [0.1 * random(), 0.3 * random()];
  const own = { state: [], environment: [], action: [] };
  for (let t = 0; t < length; ++t, ++index) {
    const state = x.map(Math.fround);
    const action = [0.1, -0.3 * x[1] + 0.05 * random()].map(Math.fround);
    x = [x[0] + action[0], x[1] + action[1]];
    const environment = Math.fround(1.5 * (episode % 2));
    frames.push({
      state, action, environment, episode, t, index,
      success: t === length - 1 && episode !== 3,
    });
    own.state.push(state);
    own.action.push(action);
    own.environment.push(environment);
  }
  expected.push(own);
}

const float = new arrow.Float32();
const fixed = new arrow.FixedSizeList(2, new arrow.Field("element", float));
const list = new arrow.List(new arrow.Field("element", float));
function arrowTable(rows, vectors) {
  const column = (get, type) => arrow.vectorFromArray(rows.map(get), type);
  return new arrow.Table({
    action: column((f) => f.action, vectors),
    "observation.state": column((f) => f.state, vectors),
    "observation.environment_state": column((f) => f.environment, float),
    timestamp: column((f) => f.t / 30, float),
    frame_index: column((f) => BigInt(f.t), new arrow.Int64()),
    episode_index: column((f) => BigInt(f.episode), new arrow.Int64()),
    index: column((f) => BigInt(f.index), new arrow.Int64()),
    task_index: column(() => 0n, new arrow.Int64()),
    task: column(() => "go right", new arrow.Utf8()),
    "next.success": column((f) => f.success, new arrow.Bool()),
  });
}
function byWasm(rows, vectors, build) {
  const table = wasm.Table.fromIPCStream(arrow.tableToIPC(arrowTable(rows, vectors), "stream"));
  return wasm.writeParquet(table, build(new wasm.WriterPropertiesBuilder()).build());
}
function byHyparquet(rows, codec) {
  const vector = (name) => [
    { name, repetition_type: "OPTIONAL", num_children: 1, converted_type: "LIST" },
    { name: "list", repetition_type: "REPEATED", num_children: 1 },
    { name: "element", type: "FLOAT", repetition_type: "OPTIONAL" },
  ];
  const columns = [
    ["action", (f) => f.action], ["observation.state", (f) => f.state],
    ["observation.environment_state", (f) => f.environment, "FLOAT"],
    ["frame_index", (f) => BigInt(f.t), "INT64"], ["episode_index", (f) => BigInt(f.episode), "INT64"],
    ["task", () => "go right", "BYTE_ARRAY"], ["next.success", (f) => f.success, "BOOLEAN"],
  ];
  const schema = [{ name: "root", num_children: columns.length }];
  for (const [name, , type] of columns) {
    schema.push(...(type ? [{ name, type, repetition_type: "OPTIONAL" }] : vector(name)));
  }
  const columnData = columns.map(([name, get]) => ({
    name, data: rows.map(get), ...(codec.encoding?.[name] ? { encoding: codec.encoding[name] } : {}),
  }));
  return new Uint8Array(parquetWriteBuffer({ columnData, schema, codec: codec.codec, rowGroupSize: codec.rows }));
}

function write(name, version, files, edit = (info) => info) {
  const folder = path.join(out, name);
  fs.rmSync(folder, { recursive: true, force: true });
  fs.mkdirSync(path.join(folder, "meta"), { recursive: true });
  for (const [file, bytes] of files) {
    const target = path.join(folder, "data", file);
    fs.mkdirSync(path.dirname(target), { recursive: true });
    fs.writeFileSync(target, bytes);
  }
  const vector = { dtype: "float32", shape: [2], names: ["x", "y"] };
  const scalar = (dtype) => ({ dtype, shape: [1], names: null });
  const info = edit({
    codebase_version: version,
    robot_type: "so100_follower",
    total_episodes: 24,
    total_frames: frames.length,
    total_tasks: 1,
    chunks_size: 1000,
    fps: 30,
    splits: { train: "0:20", test: "20:24" },
    data_path: "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
    features: {
      action: vector,
      "observation.state": vector,
      "observation.environment_state": scalar("float32"),
      "observation.images.top": { dtype: "video", shape: [480, 640, 3], names: ["height", "width", "channels"] },
      "next.success": scalar("bool"),
      timestamp: scalar("float32"),
      frame_index: scalar("int64"),
      episode_index: scalar("int64"),
      index: scalar("int64"),
      task_index: scalar("int64"),
    },
  });
  fs.writeFileSync(path.join(folder, "meta/info.json"), JSON.stringify(info, null, 4));
}
const episodes = (first, end) => frames.filter((f) => f.episode >= first && f.episode < end);
const perEpisode = (make) =>
  expected.map((_, i) => [`chunk-000/episode_${String(i).padStart(6, "0")}.parquet`, make(episodes(i, i + 1))]);

fs.mkdirSync(out, { recursive: true });
fs.writeFileSync(path.join(out, "expected.json"), JSON.stringify(expected));
// Writes version 2.1 as the datasets library does: dictionaries, Snappy, a file for each episode.
write("v21", "v2.1", perEpisode((rows) => byWasm(rows, fixed, (p) => p.setCompression(wasm.Compression.SNAPPY))));
// Writes version 3.0: many episodes in a file. Here, row groups end in the middle of some episodes.
write("v30", "v3.0", [[0, 11], [11, 24]].map(([first, end], i) => [
  `chunk-000/file-00${i}.parquet`,
  byWasm(episodes(first, end), list, (p) => p.setCompression(wasm.Compression.ZSTD).setMaxRowGroupSize(50)),
]));
// Pages of version 2, several to a column, without dictionaries.
write("pages2", "v3.0", [["chunk-000/file-000.parquet", byWasm(frames, list, (p) =>
  p.setWriterVersion(wasm.WriterVersion.V2).setDictionaryEnabled(false).setEncoding(wasm.Encoding.PLAIN)
    .setCompression(wasm.Compression.ZSTD).setDataPageSizeLimit(300).setWriteBatchSize(16))]]);
write("plain", "v3.0", [["chunk-000/file-000.parquet", byWasm(frames, fixed, (p) =>
  p.setDictionaryEnabled(false).setCompression(wasm.Compression.UNCOMPRESSED))]]);
write("hyparquet", "v3.0", [["chunk-000/file-000.parquet", byHyparquet(frames, { codec: "SNAPPY", rows: 100 })]]);
write("hyparquet_plain", "v2.1", perEpisode((rows) => byHyparquet(rows, { codec: "UNCOMPRESSED" })));
// Datasets that are refused.
write("gzip", "v3.0", [["chunk-000/file-000.parquet", byWasm(frames, list, (p) => p.setCompression(wasm.Compression.GZIP))]]);
write("delta", "v3.0", [["chunk-000/file-000.parquet",
  byHyparquet(frames, { codec: "SNAPPY", encoding: { episode_index: "DELTA_BINARY_PACKED" } })]]);
// Half precision and large unsigned integers; an episode of one frame; a file that macOS leaves behind.
const unsigned = [...frames, { ...frames[0], episode: 24, t: 0, index: frames.length }];
const counter = (f) => 4294967295 - f.index;
const withCounter = (info) => ({
  ...info, total_episodes: 25, total_frames: unsigned.length,
  features: { ...info.features, "observation.counter": { dtype: "uint32", shape: [1], names: null },
    "observation.environment_state": { dtype: "float16", shape: [1], names: null } },
});
const halves = new arrow.Table({
  action: arrow.vectorFromArray(unsigned.map((f) => f.action), fixed),
  "observation.state": arrow.vectorFromArray(unsigned.map((f) => f.state), fixed),
  "observation.environment_state": arrow.vectorFromArray(unsigned.map((f) => f.environment), new arrow.Float16()),
  "observation.counter": arrow.vectorFromArray(unsigned.map(counter), new arrow.Uint32()),
  episode_index: arrow.vectorFromArray(unsigned.map((f) => f.episode), new arrow.Uint32()),
  "next.success": arrow.vectorFromArray(unsigned.map((f) => f.success), new arrow.Bool()),
});
write("half", "v3.0", [
  ["chunk-000/file-000.parquet", wasm.writeParquet(wasm.Table.fromIPCStream(arrow.tableToIPC(halves, "stream")),
    new wasm.WriterPropertiesBuilder().build())],
  ["chunk-000/._file-000.parquet", new Uint8Array([0, 5, 22, 7])],
], withCounter);
const holes = frames.map((f, i) => (i === 45 ? { ...f, state: [null, 1] } : f));
write("holes", "v3.0", [["chunk-000/file-000.parquet", byHyparquet(holes, { codec: "SNAPPY" })]]);
const ragged = frames.map((f, i) => (i === 45 ? { ...f, action: [1, 1, 1] } : f));
write("ragged", "v3.0", [["chunk-000/file-000.parquet", byHyparquet(ragged, { codec: "SNAPPY" })]]);
