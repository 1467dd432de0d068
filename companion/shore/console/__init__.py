"""`aritra shore`: a local web console that sees boats over zenoh and gives them orders. Docs: docs/shore.md.

    zenoh's threads     zenoh_client: (boat, topic, bytes) into a bounded queue
    loop, every 0.1 s   store: checked, kept, bounded -> fan_out: what each browser is due -> web_server: WebSocket
    loop, at once       POST /order -> orders: signed, repeated until answered -> the boat's answer, word for word

`store`, `fan_out` and `request_auth` are pure: time is an argument, and nothing in them waits.
"""
