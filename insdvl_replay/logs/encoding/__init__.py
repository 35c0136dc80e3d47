"""Bytes of messages to columns of chosen fields: CDR, JSON and protobuf, by one language of field paths.

`message_encodings` knows which encoding a channel has; `ros2msg` and `layout` say where a field stands in `cdr`;
`json_fields` and `protobuf_fields` share `decoded_fields`. `field_paths` is the language.
"""
