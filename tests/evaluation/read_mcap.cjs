// Decode every message of an MCAP file with Foxglove's own reader; print counts and last values.
const { readFileSync } = require("node:fs");
const { McapIndexedReader } = require("@mcap/core");
const { loadDecompressHandlers, protobufFromBinaryDescriptor } = require("@mcap/support");

function decoderFor(channel, schema) {
  if (channel.messageEncoding === "cdr" && schema.name === "std_msgs/msg/String") {
    return (data) => {
      const length = new DataView(data.buffer, data.byteOffset).getUint32(4, true);
      return { data: new TextDecoder().decode(data.subarray(8, 8 + length - 1)) };
    };
  }
  const type = protobufFromBinaryDescriptor(schema.data).lookupType(schema.name);
  return (data) => type.toObject(type.decode(data), { defaults: true, longs: String });
}

async function main(path) {
  const bytes = readFileSync(path);
  const readable = {
    size: async () => BigInt(bytes.length),
    read: async (offset, length) => bytes.subarray(Number(offset), Number(offset + length)),
  };
  const decompressHandlers = await loadDecompressHandlers();
  const reader = await McapIndexedReader.Initialize({ readable, decompressHandlers });
  const decoders = new Map();
  const topics = {};
  for await (const message of reader.readMessages()) {
    const channel = reader.channelsById.get(message.channelId);
    if (!decoders.has(channel.id)) {
      decoders.set(channel.id, decoderFor(channel, reader.schemasById.get(channel.schemaId)));
    }
    const last = decoders.get(channel.id)(message.data);
    const count = (topics[channel.topic]?.count ?? 0) + 1;
    topics[channel.topic] = { count, time: String(message.logTime), last };
  }
  const metadata = {};
  for await (const record of reader.readMetadata()) {
    metadata[record.name] = Object.fromEntries(record.metadata);
  }
  const attachments = {};
  for await (const record of reader.readAttachments()) {
    attachments[record.name] = record.data.byteLength;
  }
  console.log(JSON.stringify({ topics, metadata, attachments }));
}

main(process.argv[2]);
