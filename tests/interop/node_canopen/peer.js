/* An independent CANopen device on SocketCAN, told what to do by JSON lines on stdin: `node peer.js vcan0`.
 *
 * A request {"id": n, "do": name, ...} is answered by {"id": n, ...}; what the stack reports by itself comes as {"event": ...}.
 * Bytes travel as hex. Ends with its stdin. Nothing in here knows our side.
 */
'use strict';

const readline = require('node:readline');
const { Device, DataType } = require('canopen');
const can = require('socketcan');

const TIMEOUT_MS = 30000; // a guest on a busy host is slow
const channel = can.createRawChannel(process.argv[2], true);
let device = null;

const say = (object) => process.stdout.write(JSON.stringify(object) + '\n');

const actions = {
    /* A new device in place of the last: its objects, the peers it knows, its PDOs. */
    start({ node, objects = [], servers = [], serveTo = [], heartbeats = [], emergencies = [], emergencyId, producerMs,
            rpdos = [], tpdos = [], syncPeriodUs }) {
        actions.stop();
        const made = new Device({ id: node });
        const eds = made.eds;
        for (const { index, type, value, access, name } of objects) {
            const entry = eds.addEntry(index, {
                parameterName: name || `object ${index.toString(16)}`, dataType: DataType[type], accessType: access || 'rw',
            });
            if (typeof value === 'string' && type === 'DOMAIN')
                entry.raw = Buffer.from(value, 'hex');
            else if (value !== undefined)
                entry.value = value;
        }
        for (const server of servers)
            eds.addSdoClientParameter(server, 0x600 + server, 0x580 + server);
        for (const client of serveTo)
            eds.addSdoServerParameter(client, 0x580 + node, 0x600 + node);
        for (const { node: watched, ms } of heartbeats)
            eds.addHeartbeatConsumer(watched, ms);
        for (const cobId of emergencies)
            eds.addEmcyConsumer(cobId);
        if (emergencyId !== undefined)
            eds.setEmcyCobId(emergencyId);
        if (producerMs !== undefined)
            eds.setHeartbeatProducerTime(producerMs);
        const mapped = (pdo) => ({
            cobId: pdo.cobId,
            transmissionType: pdo.transmissionType,
            dataObjects: pdo.objects.map((index) => eds.getEntry(index)),
        });
        for (const pdo of rpdos)
            eds.addReceivePdo(mapped(pdo));
        for (const pdo of tpdos)
            eds.addTransmitPdo(mapped(pdo));
        eds.setSyncCobId(0x80);
        eds.setSyncGenerationEnable(true);
        if (syncPeriodUs !== undefined)
            eds.setSyncCyclePeriod(syncPeriodUs);
        made.sdoServer.setBlockInterval(0);
        made.on('message', (message) => channel.send(message));
        made.nmt.on('heartbeat', ({ deviceId, state }) => say({ event: 'heartbeat', node: deviceId, state }));
        made.nmt.on('timeout', (deviceId) => say({ event: 'heartbeat lost', node: deviceId }));
        made.nmt.on('changeState', (state) => say({ event: 'state', state }));
        made.emcy.on('emergency', ({ cobId, em }) => say({
            event: 'emergency', cobId, code: em.code, register: em.register, info: em.info.toString('hex'),
        }));
        made.pdo.on('pdo', ({ cobId, dataObjects }) => say({
            event: 'pdo', cobId, values: dataObjects.map((object) => object.value),
        }));
        device = made;
        device.start();
    },
    stop() {
        if (device) {
            const old = device;
            device = null;
            old.stop();
            old.removeAllListeners();
        }
    },
    async upload({ server, index, subindex, block = false }) {
        const data = await device.sdo.upload({
            serverId: server, index, subIndex: subindex, blockTransfer: block, timeout: TIMEOUT_MS,
        });
        return { data: data.toString('hex') };
    },
    async download({ server, index, subindex, data, block = false }) {
        await device.sdo.download({
            serverId: server, index, subIndex: subindex, data: Buffer.from(data, 'hex'), blockTransfer: block,
            timeout: TIMEOUT_MS,
        });
    },
    nmt({ command, node }) {
        device.nmt[command](node);
    },
    sync() {
        device.sync.write();
    },
    set({ index, value }) {
        device.setValue(index, value);
    },
    get({ index }) {
        return { data: device.getRaw(index).toString('hex') };
    },
    write({ cobId }) {
        device.pdo.write(cobId);
    },
    emergency({ code, info = '' }) {
        device.emcy.write(code, Buffer.from(info, 'hex')); // its form with an object loses the code
    },
};

channel.addListener('onMessage', (message) => device && device.receive(message));
channel.start();

readline.createInterface({ input: process.stdin }).on('line', async (line) => {
    const request = JSON.parse(line);
    try {
        say({ id: request.id, ...(await actions[request.do](request)) });
    }
    catch (error) {
        say({ id: request.id, error: String(error.message || error), code: error.code });
    }
}).on('close', () => {
    actions.stop();
    channel.stop();
    process.exit(0);
});

say({ event: 'ready' });
