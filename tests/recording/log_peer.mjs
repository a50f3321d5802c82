// Reads our logs with @mcap/core, and their messages by the definitions in the file with
// @foxglove/rosmsg2-serialization: neither shares code with dfr.
// usage: log_peer.mjs RUNTIME finished FOLDER | log_peer.mjs RUNTIME killed RECORDING_CHILD FOLDER
import assert from "node:assert/strict";
import { spawn } from "node:child_process";
import fs from "node:fs";
import { createRequire } from "node:module";
import path from "node:path";
import { setTimeout as sleep } from "node:timers/promises";

const [runtime, what, ...rest] = process.argv.slice(2);
const require = createRequire(path.join(path.resolve(runtime), "package.json"));
const { McapIndexedReader, McapStreamReader } = require("@mcap/core");
const { parse } = require("@foxglove/rosmsg");
const { MessageReader } = require("@foxglove/rosmsg2-serialization");

const kTypes = {
  "/dfr/step": "dfr_msgs/msg/Step",
  "/dfr/transition": "dfr_msgs/msg/Transition",
  "/dfr/image/compressed": "sensor_msgs/msg/CompressedImage",
  "/dfr/log": "rcl_interfaces/msg/Log",
  "/dfr/arm": "dfr_msgs/msg/Arm",
};

function bits(value) {
  const view = new DataView(new ArrayBuffer(8));
  view.setFloat64(0, value);
  return view.getBigUint64(0).toString();
}

// Collects the messages by topic, decoded by the schemas in the file.
class Decoder {
  readers = new Map();
  messages = Object.fromEntries(Object.keys(kTypes).map((topic) => [topic, []]));

  channel(channel, schema) {
    assert.equal(schema.name, kTypes[channel.topic]);
    assert.equal(schema.encoding, "ros2msg");
    assert.equal(channel.messageEncoding, "cdr");
    const definition = new TextDecoder().decode(schema.data);
    const reader = new MessageReader(parse(definition, { ros2: true }));
    this.readers.set(channel.id, { topic: channel.topic, reader });
  }
  message(message) {
    const { topic, reader } = this.readers.get(message.channelId);
    const content = reader.readMessage(message.data);
    assert.equal(message.logTime, message.publishTime);
    const stamp = content.stamp ?? content.header.stamp;
    assert.equal(BigInt(stamp.sec) * 1_000_000_000n + BigInt(stamp.nanosec), message.logTime);
    this.messages[topic].push({ ...content, logTime: message.logTime, sequence: message.sequence });
  }
}

function check_step(step, expected) {
  assert.equal(step.logTime.toString(), expected.time_ns);
  for (const key of ["episode", "seed", "image_sequence", "image_time_ns"]) {
    assert.equal(step[key].toString(), expected[key], key);
  }
  for (const key of ["t", "iteration", "mode", "cause", "machine"]) {
    assert.equal(step[key], expected[key], key);
  }
  for (const key of ["applied", "filtered", "certified"]) {
    assert.equal(Number(step[key]), expected[key], key);
  }
  for (const key of ["g", "log_g", "threshold", "decision_s"]) {
    // JavaScript may lose a NaN's payload, and nothing else.
    if (Number.isNaN(step[key])) assert.equal(BigInt(expected[key]) >> 51n, 0xfffn);
    else assert.equal(bits(step[key]), expected[key], key);
  }
  for (const key of ["state", "command"]) {
    assert.equal(step[key].length, expected[key].length, key);
    step[key].forEach((value, i) => {
      if (Number.isNaN(value)) assert.equal(BigInt(expected[key][i]) >> 51n, 0xfffn);
      else assert.equal(bits(value), expected[key][i], `${key}[${i}]`);
    });
  }
}

function check_content({ messages }, expected) {
  const steps = messages["/dfr/step"];
  assert.equal(steps.length, expected.steps.length);
  steps.forEach((step, i) => check_step(step, expected.steps[i]));
  const transitions = messages["/dfr/transition"];
  assert.equal(transitions.length, expected.transitions.length);
  transitions.forEach((transition, i) => {
    for (const [key, value] of Object.entries(expected.transitions[i])) {
      assert.equal(transition[key], value);
    }
  });
  const arm = messages["/dfr/arm"];
  assert.equal(arm.length, expected.arm.length);
  arm.forEach((state, i) => {
    const wanted = expected.arm[i];
    assert.equal(state.logTime.toString(), wanted.time_ns);
    assert.equal(state.measured_ns.toString(), wanted.measured_ns);
    for (const key of ["operating_state", "machine", "fault", "stop"]) {
      assert.equal(state[key], wanted[key], key);
    }
    for (const key of ["homed", "busy"]) assert.equal(Number(state[key]), wanted[key], key);
    for (const key of ["position", "velocity", "setpoint", "console_setpoint"]) {
      assert.deepEqual([...state[key]].map(bits), wanted[key], key);
    }
  });
  const pictures = messages["/dfr/image/compressed"];
  assert.equal(pictures.length, expected.pictures);
  pictures.forEach((picture, i) => {
    assert.equal(picture.sequence, i);
    assert.equal(picture.format, "jpeg");
    assert.deepEqual([...picture.data.slice(0, 3)], [0xff, 0xd8, 0xff]);
    assert.deepEqual([...picture.data.slice(-2)], [0xff, 0xd9]);
  });
  assert.equal(messages["/dfr/log"].length, 0);
}

// Passes on all records in order and checks all checksums.
function stream(bytes, on_record) {
  const reader = new McapStreamReader({ validateCrcs: true });
  reader.append(bytes);
  for (let record; (record = reader.nextRecord()); ) on_record(record);
  return reader.done();
}

function decode_stream(bytes) {
  const decoder = new Decoder();
  const schemas = new Map();
  const others = [];
  const done = stream(bytes, (record) => {
    if (record.type === "Schema") schemas.set(record.id, record);
    else if (record.type === "Channel") decoder.channel(record, schemas.get(record.schemaId));
    else if (record.type === "Message") decoder.message(record);
    else others.push(record);
  });
  return { decoder, others, done };
}

async function finished(folder) {
  const bytes = fs.readFileSync(path.join(folder, "log.mcap"));
  const expected = JSON.parse(fs.readFileSync(path.join(folder, "log.json")));

  // Reads the file from front to back.
  const { decoder, others, done } = decode_stream(bytes);
  assert.ok(done);
  check_content(decoder, expected);
  const metadata = others.find(({ type }) => type === "Metadata");
  assert.equal(metadata.name, "dfr");
  assert.equal(metadata.metadata.get("seed"), "18446744073709551615");
  const attachment = others.find(({ type }) => type === "Attachment");
  assert.equal(attachment.name, "configuration");
  assert.equal(new TextDecoder().decode(attachment.data), '[robot]\narm = "PSM1"\n');

  // Reads the file by its indexes.
  const readable = {
    size: async () => BigInt(bytes.length),
    read: async (offset, size) => bytes.subarray(Number(offset), Number(offset + size)),
  };
  const reader = await McapIndexedReader.Initialize({ readable });
  assert.equal(reader.header.library, "dfr");
  assert.equal(reader.channelsById.size, 5);
  assert.equal(reader.schemasById.size, 5);
  const total = expected.steps.length + expected.transitions.length + expected.arm.length + expected.pictures;
  assert.equal(reader.statistics.messageCount, BigInt(total));
  assert.equal(reader.statistics.channelMessageCounts.get(1), BigInt(expected.steps.length));
  assert.equal(reader.statistics.chunkCount, reader.chunkIndexes.length);
  assert.equal(reader.statistics.messageStartTime.toString(), expected.steps[0].time_ns);
  assert.equal(reader.statistics.messageEndTime.toString(), expected.steps.at(-1).time_ns);
  assert.equal(reader.summaryOffsetsByOpcode.size, 6);
  const indexed = new Decoder();
  for (const channel of reader.channelsById.values()) {
    indexed.channel(channel, reader.schemasById.get(channel.schemaId));
  }
  for await (const message of reader.readMessages({ validateCrcs: true })) indexed.message(message);
  check_content(indexed, expected);
  const some = [];
  const startTime = BigInt(expected.steps[10].time_ns);
  const endTime = BigInt(expected.steps[19].time_ns);
  for await (const message of reader.readMessages({ topics: ["/dfr/step"], startTime, endTime })) {
    some.push(message);
  }
  assert.equal(some.length, 10);
  const names = [];
  for await (const { name } of reader.readAttachments()) names.push(name);
  for await (const { name } of reader.readMetadata()) names.push(name);
  assert.deepEqual(names, ["configuration", "dfr"]);
  console.log(`${total} messages by ${reader.chunkIndexes.length} chunks`);
}

async function killed(child, folder) {
  fs.mkdirSync(folder, { recursive: true });
  const log = path.join(folder, "killed.mcap");
  const progress = path.join(folder, "progress");
  for (const after_ms of [450, 1170, 733]) {
    fs.rmSync(log, { force: true });
    const process = spawn(child, [log, progress], { stdio: "inherit" });
    const ended = new Promise((resolve) => process.on("exit", (_code, signal) => resolve(signal)));
    await sleep(after_ms);
    process.kill("SIGKILL");
    assert.equal(await ended, "SIGKILL");
    const recorded = fs.statSync(progress).size; // one byte a step, one step a millisecond
    const whole = fs.readFileSync(log);
    const { decoder } = decode_stream(whole);
    const steps = decoder.messages["/dfr/step"];
    console.log(`killed after ${after_ms} ms: ${steps.length} of ${recorded} steps`);
    assert.ok(recorded - steps.length < 1000);
    steps.forEach((step, i) => assert.equal(step.sequence, i + 1));

    // Truncated at any byte, the file gives a part of the steps.
    for (let size = 8; size < whole.length; size += 997) {
      const cut = decode_stream(whole.subarray(0, size)).decoder.messages["/dfr/step"];
      assert.ok(cut.length <= steps.length);
      cut.forEach((step, i) => assert.equal(step.sequence, i + 1));
    }
  }
}

await { finished, killed }[what](...rest);
