// A client of another make than the server's: node-opcua. It prints what it found as one line of JSON.
// node other_make.js ENDPOINT CERTIFICATE.pem KEY.pem FOLDER APPLICATION_URI
"use strict";
const opcua = require("node-opcua-client");
const { OPCUACertificateManager } = require("node-opcua-certificate-manager");
const [endpoint, certificateFile, privateKeyFile, rootFolder, applicationUri] = process.argv.slice(2);

const fields = ["EventId", "ConditionName", "ActiveState.Id", "AckedState.Id", "Message", "Severity"];

async function main() {
  const manager = new OPCUACertificateManager({ rootFolder, automaticallyAcceptUnknownCertificate: true });
  await manager.initialize();
  const client = opcua.OPCUAClient.create({
    applicationName: "other make", applicationUri, certificateFile, privateKeyFile,
    clientCertificateManager: manager,
    securityMode: opcua.MessageSecurityMode.SignAndEncrypt,
    securityPolicy: opcua.SecurityPolicy.Basic256Sha256,
    endpointMustExist: false,
    connectionStrategy: { maxRetry: 0 },
  });
  const found = { events: [], values: [] };
  await client.connect(endpoint);
  const session = await client.createSession();
  const namespaces = (await session.read({ nodeId: "i=2255", attributeId: opcua.AttributeIds.Value })).value.value;
  const index = namespaces.indexOf("urn:valve_sim:station");
  const node = (name) => `ns=${index};s=${name}`;
  const browsed = await session.browse(node("tank_2/valve"));
  found.children = browsed.references.map((reference) => reference.browseName.name);
  const unit = await session.read({ nodeId: node("tank_2/valve.Stroke.T1.EngineeringUnits"), attributeId: 13 });
  found.unit = unit.value.value.unitId;

  const subscription = await session.createSubscription2({ requestedPublishingInterval: 50, publishingEnabled: true });
  const filter = opcua.constructEventFilter(fields, [opcua.resolveNodeId("ConditionType")]);
  let acknowledge;
  const isSeen = new Promise((resolve) => (acknowledge = resolve));
  const events = await subscription.monitor(
    { nodeId: "i=2253", attributeId: opcua.AttributeIds.EventNotifier },
    { samplingInterval: 10, discardOldest: true, queueSize: 100, filter }, opcua.TimestampsToReturn.Both);
  let isDone = false;
  let ended;
  const isAcknowledged = new Promise((resolve) => (ended = resolve));
  events.on("changed", (variants) => {
    const event = Object.fromEntries(fields.map((name, place) => [name, variants[place].value]));
    found.events.push({ active: event["ActiveState.Id"], acknowledged: event["AckedState.Id"],
                        severity: event.Severity });
    if (event["ActiveState.Id"] && !event["AckedState.Id"]) acknowledge(event.EventId);
    if (event["AckedState.Id"]) ended();
  });
  const values = await subscription.monitor(
    { nodeId: node("tank_2/valve.Stroke.T1"), attributeId: opcua.AttributeIds.Value },
    { samplingInterval: 10, discardOldest: true, queueSize: 100 }, opcua.TimestampsToReturn.Both);
  values.on("changed", (value) => {
    found.values.push(value.value.value);
    if (!isDone) { isDone = true; console.log("subscribed"); }
  });
  const eventId = await isSeen;
  const condition = node("tank_2/valve.Alarm");
  found.acknowledge = (await session.acknowledgeCondition(condition, eventId, "seen")).name;
  found.again = (await session.acknowledgeCondition(condition, eventId, "seen")).name;
  await isAcknowledged;
  const history = await session.readHistoryValue(node("tank_2/valve.Stroke.T1"), new Date("2020-01-01"), new Date("2040-01-01"));
  found.history = history.historyData.dataValues.map((value) => [value.value.value, value.sourceTimestamp.toISOString()]);
  const called = await session.call({ objectId: node("tank_2/valve"), methodId: node("tank_2/valve.Recommission"), inputArguments: [] });
  found.called = called.outputArguments.map((argument) => argument.value);
  await subscription.terminate();
  await session.close();
  await client.disconnect();
  console.log(JSON.stringify(found));
  process.exit(0);
}

main().catch((error) => { console.error(error.message); process.exit(1); });
