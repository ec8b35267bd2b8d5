// node check.mjs FILE.mcap: reads it whole with the reference reader and prints what is in it, one "topic count" a line.
// Every image must be a PNG, every time of the index must be in order.
import { readFile } from "node:fs/promises";
import { McapIndexedReader, McapStreamReader } from "@mcap/core";

const bytes = new Uint8Array(await readFile(process.argv[2]));
const file = {
  size: async () => BigInt(bytes.length),
  read: async (offset, size) => bytes.slice(Number(offset), Number(offset + size)),
};
// By the index, with its checksums.
const reader = await McapIndexedReader.Initialize({ readable: file });
const counts = new Map();
let last = 0n;
for await (const message of reader.readMessages()) {
  const channel = reader.channelsById.get(message.channelId);
  const schema = reader.schemasById.get(channel.schemaId);
  const content = JSON.parse(new TextDecoder().decode(message.data));
  const needed = Object.keys(JSON.parse(new TextDecoder().decode(schema.data)).properties);
  for (const key of needed) if (!(key in content)) throw new Error(`${channel.topic}: ${key} is missing`);
  if (message.logTime < last) throw new Error("messages are out of order");
  last = message.logTime;
  if (schema.name === "foxglove.CompressedImage") {
    const png = Buffer.from(content.data, "base64");
    if (png.subarray(1, 4).toString() !== "PNG" || content.format !== "png") throw new Error("an image is no PNG");
  }
  counts.set(channel.topic, (counts.get(channel.topic) ?? 0) + 1);
}
if (reader.statistics.messageCount !== BigInt([...counts.values()].reduce((a, b) => a + b, 0)))
  throw new Error("the statistics count other messages");
// From the beginning to the end, as a stream.
const stream = new McapStreamReader({ validateCrcs: true });
stream.append(bytes);
let streamed = 0;
for (let record; (record = stream.nextRecord()); ) if (record.type === "Message") ++streamed;
if (!stream.done() || BigInt(streamed) !== reader.statistics.messageCount) throw new Error("as a stream it holds other messages");
for (const [topic, count] of [...counts].sort()) console.log(`${topic} ${count}`);
