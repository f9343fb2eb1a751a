"""Pings the daemon with tmtccmd; runs in its own environment, since it pins another spacepackets.

python tmtccmd_ping.py PORT  ->  one JSON line: the verification chain as tmtccmd has seen it
"""

import json
import sys
import time

from spacepackets.ccsds.spacepacket import PacketId, PacketType
from spacepackets.ecss import PusTc
from spacepackets.ecss.pus_1_verification import Service1Tm, UnpackParams
from spacepackets.ecss.pus_verificator import PusVerificator
from spacepackets.ecss.tm import PusTm
from tmtccmd.com.tcp import TcpSpacepacketsClient
from tmtccmd.com.tcpip_utils import EthAddr

APID, CUC_BYTES, PATIENCE_S = 100, 8, 120.0


def main(port: int) -> int:
    known = [PacketId(PacketType.TM, sec_header_flag=True, apid=apid) for apid in (APID, 102)]
    client = TcpSpacepacketsClient("tcp", known, 0.05, EthAddr("127.0.0.1", port))
    client.open()
    ping = PusTc(service=17, subservice=1, apid=APID, seq_count=4321)
    verificator = PusVerificator()
    verificator.add_tc(ping)
    client.send(ping.pack())
    stages, answered, other = [], False, 0
    deadline_s = time.monotonic() + PATIENCE_S
    done = False
    while time.monotonic() < deadline_s and not (done and answered):
        for raw in client.receive():
            tm = PusTm.unpack(raw, CUC_BYTES)
            if tm.service == 17:
                answered = True
            elif tm.service == 1:
                report = Service1Tm.unpack(raw, UnpackParams(CUC_BYTES))
                result = verificator.add_tm(report)
                if result is not None:
                    stages.append(int(tm.subservice))
                    done = result.completed
            else:
                other += 1
        time.sleep(0.05)
    (entry,) = verificator.verif_dict.values()
    found = {
        "stages": stages,
        "alive": answered,
        "completed": done,
        "accepted": entry.accepted.name,
        "started": entry.started.name,
        "ended": entry.completed.name,
        "others": other,
    }
    sys.stdout.write(json.dumps(found) + "\n")
    client.close()
    return 0


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1])))
