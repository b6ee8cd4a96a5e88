"""A trained network as files for programs that have neither JAX nor this project (docs/export.md).

The numbers and the contract are the same in each file: `network` and `contract` make them, `numpy_file` and
`onnx_file` write them.
"""
