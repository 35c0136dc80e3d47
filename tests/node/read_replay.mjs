// Decodes every message of an MCAP file and prints, as JSON by topic, how many there are and the last of each.
import { open } from "node:fs/promises";
import process from "node:process";
import { parse } from "@foxglove/rosmsg";
import { MessageReader } from "@foxglove/rosmsg2-serialization";
import { McapIndexedReader } from "@mcap/core";
import { decompress } from "fzstd";

const file = await open(process.argv[2]);
const readable = {
  size: async () => BigInt((await file.stat()).size),
  read: async (offset, length) => {
    const bytes = new Uint8Array(Number(length));
    await file.read(bytes, 0, bytes.length, Number(offset));
    return bytes;
  },
};
const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers: { zstd: (data) => decompress(data) } });
const decoders = new Map();
const topics = {};
for await (const message of reader.readMessages()) {
  const channel = reader.channelsById.get(message.channelId);
  if (!decoders.has(channel.id)) {
    const schema = reader.schemasById.get(channel.schemaId);
    decoders.set(channel.id, new MessageReader(parse(new TextDecoder().decode(schema.data), { ros2: true })));
  }
  const found = (topics[channel.topic] ??= { count: 0, last: null });
  found.count += 1;
  found.last = decoders.get(channel.id).readMessage(message.data);
}
const plain = (_, value) =>
  typeof value === "bigint" ? Number(value) : ArrayBuffer.isView(value) ? [...value] : value;
console.log(JSON.stringify({ topics, stated: Number(reader.statistics.messageCount) }, plain));
await file.close();
