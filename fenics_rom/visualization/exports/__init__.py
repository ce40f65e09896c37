"""What other programs read, and what people look at: files for ParaView, stills, moving pictures, sheets of modes."""
