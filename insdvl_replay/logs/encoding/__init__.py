"""Bytes of messages to columns of chosen fields: CDR, JSON and protobuf, by one language of field paths.

`fields` is the language, and knows who reads the encoding of a channel; `ros2msg` and `layout` say where a field stands
in `cdr`; `json_fields` and `protobuf_fields` share `decoded_fields`.
"""
