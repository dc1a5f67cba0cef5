"""A live viewer that plays while a block lasts, and a client that is no browser."""

import socket
import struct
import threading
import time
from contextlib import contextmanager

import numpy as np

OWN = object()
"""The origin of the viewer's own page."""


@contextmanager
def viewing(bodies, **options):
    """A viewer that plays."""
    from retarget.view.viewer import Viewer

    viewer, over = Viewer(bodies, **options), threading.Event()
    playing = threading.Thread(target=viewer.play, args=(over.is_set,))
    playing.start()
    try:
        yield viewer
    finally:
        over.set()
        playing.join(timeout=10)
        viewer.close()


def connected(viewer, origin=OWN, host="127.0.0.1"):
    """A websocket to the viewer, whatever its name."""
    import viser
    from websockets.sync.client import connect

    port = viewer.server.get_port()
    address = f"http://{host}:{port}" if origin is OWN else origin
    return connect(
        f"ws://{host}:{port}", sock=socket.create_connection(("127.0.0.1", port), timeout=10), origin=address,
        compression=None, max_size=None, subprotocols=[f"viser-v{viser.__version__}"], open_timeout=10,
    )  # fmt: skip


def messages(packet):
    """What a packet says: viser's messages as dictionaries, arrays in their place."""
    import msgspec
    import zstandard

    size, compressed = struct.unpack_from("<QQ", packet)
    told = msgspec.msgpack.decode(zstandard.ZstdDecompressor().decompress(packet[16 : 16 + compressed], size))
    at, arrays = 16 + compressed, []
    for length in told["binaryBufferLengths"]:
        at += -at % 8
        arrays.append(packet[at : at + length])
        at += length

    def whole(value):
        if isinstance(value, dict):
            if "__binary_index" in value:
                return np.frombuffer(arrays[value["__binary_index"]], dtype=value["dtype"])
            return {key: whole(each) for key, each in value.items()}
        return [whole(each) for each in value] if isinstance(value, (list, tuple)) else value

    return [whole(each) for each in told["messages"]]


def heard(client, seconds):
    """Packets that come within some seconds."""
    end, packets = time.monotonic() + seconds, []
    while (left := end - time.monotonic()) > 0:
        try:
            packets.append(client.recv(timeout=left))
        except TimeoutError:
            break
    return packets
