// Runs exported ONNX files in ONNX Runtime on the states beside them, and compares the results with the libraries'.
// usage: onnx_peer.cjs RUNTIME_DIR CASES_DIR NUMBER_OF_CASES
const fs = require("fs");
const path = require("path");
const [runtime, cases, count] = process.argv.slice(2);
const ort = require(path.join(runtime, "node_modules", "onnxruntime-node"));

async function check(file) {
  const { model, inputs, output, expected, dims } = JSON.parse(fs.readFileSync(file));
  const session = await ort.InferenceSession.create(path.join(cases, model));
  const feeds = {};
  for (const { name, type, values, shape } of inputs) {
    feeds[name] =
      type === "int64"
        ? new ort.Tensor("int64", BigInt64Array.from(values.map(BigInt)), shape)
        : new ort.Tensor("float64", Float64Array.from(values), shape);
  }
  const actual = (await session.run(feeds))[output];
  if (actual.type !== "float64" || String(actual.dims) !== String(dims)) {
    throw new Error(`${model}: ${actual.type} of ${actual.dims}, not float64 of ${dims}`);
  }
  let worst = 0;
  actual.data.forEach((value, i) => {
    const error = Math.abs(value - expected[i]);
    if (!(error <= worst)) worst = error;
  });
  console.log(`${model}: ${expected.length} values, worst difference ${worst}`);
  // g and u are of order one.
  if (!(worst <= 1e-12)) throw new Error(`${model}: differs by ${worst}`);
}

(async () => {
  const files = fs.readdirSync(cases).filter((name) => name.endsWith(".json"));
  if (files.length !== Number(count)) throw new Error(`${files.length} cases in ${cases}, not ${count}`);
  for (const file of files) await check(path.join(cases, file));
})().catch((error) => {
  console.error(error);
  process.exit(1);
});
