"""Bytes of messages to columns of chosen fields: CDR, ROS 1, JSON and protobuf, by one language of field paths.

`fields` is the language, and knows who reads the encoding of a channel; `ros2msg` and `layout` say where a field stands
in `binary_fields`; `json_fields` and `protobuf_fields` share `decoded_fields`.
"""
