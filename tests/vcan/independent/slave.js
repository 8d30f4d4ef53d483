// A CANopen slave from the npm package `canopen` (node-canopen, MIT): frames come and go as lines "ID#HEX" on stdio.
//
//   node slave.js NODE_ID
//
// The package's only native dependency is a CRC for block transfers. It is replaced by CRC-16/XMODEM in JavaScript,
// so that nothing has to be compiled.

'use strict';

const Module = require('module');
const readline = require('readline');

const load = Module._load;
Module._load = function (request, ...rest) {
    return request === 'node-crc' ? { crc: crc16 } : load.call(this, request, ...rest);
};

function crc16(bits, reflect, polynomial, initial, ...rest) {
    let value = initial;
    for (const byte of rest[rest.length - 1]) {
        value ^= byte << 8;
        for (let bit = 0; bit < 8; bit++)
            value = (value & 0x8000) ? ((value << 1) ^ polynomial) & 0xFFFF : (value << 1) & 0xFFFF;
    }
    return Buffer.from([value >> 8, value & 0xFF]);
}

const { Device, DataType, AccessType } = require('canopen');

const id = Number(process.argv[2]);
const device = new Device({ id });
const eds = device.eds;

function add(index, name, dataType, defaultValue, accessType = AccessType.READ_WRITE) {
    return eds.addEntry(index, { parameterName: name, dataType, accessType, defaultValue });
}

const replace = (index, ...rest) => {
    if (eds.getEntry(index) !== undefined)
        eds.removeEntry(index);
    return add(index, ...rest);
};

replace(0x1000, 'Device type', DataType.UNSIGNED32, 0x00020192, AccessType.READ_ONLY);
replace(0x1008, 'Manufacturer device name', DataType.VISIBLE_STRING, 'a servo drive that others have written',
    AccessType.CONSTANT);
add(0x2000, 'Free text', DataType.VISIBLE_STRING, 'nothing yet');
const trigger = add(0x2001, 'Emergency to send', DataType.UNSIGNED16, 0);
const statusword = add(0x6041, 'Statusword', DataType.UNSIGNED16, 0x0240, AccessType.READ_ONLY);
const controlword = add(0x6040, 'Controlword', DataType.UNSIGNED16, 0);
const target = add(0x607A, 'Target position', DataType.INTEGER32, 0);
const torqueOffset = add(0x60B2, 'Torque offset', DataType.INTEGER16, 0);
const position = add(0x6064, 'Position actual value', DataType.INTEGER32, -123456, AccessType.READ_ONLY);
const torque = add(0x6077, 'Torque actual value', DataType.INTEGER16, -321, AccessType.READ_ONLY);

eds.addSdoServerParameter(id, 0x580 | id, 0x600 | id);
eds.setHeartbeatProducerTime(50);
eds.addHeartbeatConsumer(127, 300);
eds.setEmcyCobId(0x80 | id);
eds.setSyncCobId(0x80);
eds.addTransmitPdo({ cobId: 0x180 | id, transmissionType: 1, dataObjects: [statusword, position, torque] });
eds.addReceivePdo({ cobId: 0x200 | id, transmissionType: 255, dataObjects: [controlword, target, torqueOffset] });

trigger.addListener('update', () => {
    if (trigger.value !== 0)
        device.emcy.write(trigger.value, Buffer.from([1, 2, 3, 4, 5]));
});

// What the master commands shows up in the actual values, so that a round trip can be seen on the bus.
device.pdo.on('pdo', () => {
    position.value = target.value;
    statusword.value = 0x0200 | (controlword.value & 0xFF);
});

device.nmt.addListener('timeout', (other) => process.stdout.write(`!timeout ${other}\n`));
device.nmt.addListener('heartbeat', ({ deviceId }) => process.stdout.write(`!heartbeat ${deviceId}\n`));

device.addListener('message', ({ id: cobId, data }) => {
    process.stdout.write(`${cobId.toString(16)}#${Buffer.from(data || []).toString('hex')}\n`);
});

readline.createInterface({ input: process.stdin }).on('line', (line) => {
    const [cobId, hex] = line.split('#');
    const data = Buffer.from(hex, 'hex');
    device.receive({ id: parseInt(cobId, 16), data, len: data.length });
}).on('close', () => process.exit(0));

device.start();
process.stdout.write('!ready\n');
