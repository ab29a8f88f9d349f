"""Writes of a Modbus drive: composed from the profile's registers and coils, and recognized again in a frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from drivebus.drives.dialects.modbus_reads import join_words, split_words
from drivebus.profiles.model import DriveProfile, Parameter
from drivebus.profiles.words import CommandMap, FixedWrite
from drivebus.protocols.family import Locator
from drivebus.protocols.modbus import RegisterWrite, WriteBit, WriteBits, WriteRegister, WriteRegisters

WriteRequest = WriteRegister | WriteRegisters | WriteBit | WriteBits


@dataclass(frozen=True, slots=True)
class CommandWrite:
    """Command word in a frame."""

    word: int
    width: int


@dataclass(frozen=True, slots=True)
class SetpointWrite:
    """Whole setpoint in a frame."""

    word: int
    width: int


@dataclass(frozen=True, slots=True)
class ResetWrite:
    """Fault reset in a register of its own."""

    width: int = 1


@dataclass(frozen=True, slots=True)
class UnlockWrite:
    """Write without which the drive rejects every command."""

    width: int = 1


@dataclass(frozen=True, slots=True)
class ParameterWrite:
    """Whole writable parameter in a frame."""

    parameter: Parameter
    width: int


RecognizedWrite = CommandWrite | SetpointWrite | ResetWrite | UnlockWrite | ParameterWrite


class ModbusWrites:
    """Writes of one station."""

    def __init__(self, address: int, profile: DriveProfile, commands: CommandMap | None) -> None:
        self.address, self.profile, self.commands = address, profile, commands
        self._features = profile.modbus_features
        self._parameters = _writable_parameters(profile)

    def command(self, word: int) -> WriteRequest:
        """Return the write of a command word: to registers, to the coils that are its bits, or to the coil it names."""
        assert self.commands is not None
        register = self.commands.register
        match self.commands.written_to:
            case "coils":
                return WriteBits(self.address, register, coil_bits(word, self.commands.coil_count))
            case "coil":
                return self._coil(register + word, value=True)
        return self.registers(register, word, self.commands.words)

    def setpoint(self, word: int) -> WriteRequest:
        """Return the write of a whole setpoint: one of two registers is one frame."""
        assert self.commands is not None
        return self.registers(self.commands.setpoint_register, word, self.profile.setpoint_scale.words)

    def reset_register(self) -> WriteRequest | None:
        """Return the fault reset in a register of its own, None where the command word has it."""
        return self._fixed(self.commands.reset if self.commands is not None else None)

    def unlock(self) -> WriteRequest | None:
        """Return the write without which the drive rejects every command, None where it needs none."""
        return self._fixed(self.commands.unlock if self.commands is not None else None)

    def _fixed(self, write: FixedWrite | None) -> WriteRequest | None:
        return None if write is None else self.registers(write.register, write.value, 1)

    def parameter(self, parameter: Parameter, raw: int, *, save: bool) -> WriteRequest:
        """Return the write of a parameter, at its EEPROM address where it is to be saved."""
        space, index = parameter.locator
        if space == "coil":
            return self._coil(index, value=bool(raw))
        return self.registers(self.profile.write_support.address(index, save=save), raw, parameter.scale.words)

    def _coil(self, index: int, *, value: bool) -> WriteBit | WriteBits:
        """Return the write of one coil: function 05, or 0FH on a model that lacks 05."""
        if WriteBit.function in self._features.functions:
            return WriteBit(self.address, index, value)
        return WriteBits(self.address, index, (value,))

    def registers(self, register: int, number: int, count: int) -> WriteRequest:
        """Return the write of a number: function 06 for one register, 10H for more or on a model that lacks 06."""
        if count == 1 and WriteRegister.function in self._features.functions:
            return WriteRegister(self.address, register, number)
        return WriteRegisters(self.address, register, split_words(number, count, self._features))

    def recognize(self, changes: Sequence[RegisterWrite]) -> list[RecognizedWrite] | None:
        """Return what a frame writes; None where a change is unknown, or half of a number in two registers."""
        recognized: list[RecognizedWrite] = []
        place = 0
        while place < len(changes):
            write = self._recognize_first(changes[place:])
            if write is None:
                return None
            recognized.append(write)
            place += write.width
        return recognized

    def _recognize_first(self, changes: Sequence[RegisterWrite]) -> RecognizedWrite | None:
        space, register, value = changes[0]
        commands = self.commands
        if space == "coil":
            return self._recognize_coils(changes)
        if commands is not None and commands.written_to == "register" and register == commands.register:
            word = self._number(changes, commands.words)
            return None if word is None else CommandWrite(word, commands.words)
        if commands is not None and register == commands.setpoint_register:
            width = self.profile.setpoint_scale.words
            word = self._number(changes, width)
            return None if word is None else SetpointWrite(word, width)
        if commands is not None and commands.reset is not None and register == commands.reset.register:
            return ResetWrite() if value == commands.reset.value else None
        if commands is not None and commands.unlock is not None and register == commands.unlock.register:
            return UnlockWrite() if value == commands.unlock.value else None
        parameter = self._parameters.get((space, register))
        if parameter is None or len(changes) < parameter.scale.words:
            return None
        return ParameterWrite(parameter, parameter.scale.words)

    def _recognize_coils(self, changes: Sequence[RegisterWrite]) -> CommandWrite | ParameterWrite | None:
        """Recognize the whole command word in coils, or the one coil that is a command; never a part."""
        commands = self.commands
        space, first, value = changes[0]
        parameter = self._parameters.get((space, first))
        if parameter is not None:
            return ParameterWrite(parameter, 1)
        if commands is None or first < commands.register:
            return None
        if commands.written_to == "coil":
            return CommandWrite(first - commands.register, 1) if value else None
        if commands.written_to != "coils" or first != commands.register or len(changes) != commands.coil_count:
            return None
        return CommandWrite(sum(bit << place for place, (_, _, bit) in enumerate(changes)), commands.coil_count)

    def _number(self, changes: Sequence[RegisterWrite], count: int) -> int | None:
        return join_words((value for _, _, value in changes[:count]), self._features) if len(changes) >= count else None


def coil_bits(word: int, count: int) -> tuple[bool, ...]:
    """Return the bits of a word, the lowest first."""
    return tuple(bool(word >> place & 1) for place in range(count))


def _writable_parameters(profile: DriveProfile) -> dict[Locator, Parameter]:
    """Return the writable parameters by locator; one that can be read also by its EEPROM or RAM address."""
    support = profile.write_support
    by_locator: dict[Locator, Parameter] = {}
    for parameter in profile.parameters.values():
        space, index = parameter.locator
        if parameter.writable:
            has_twin = parameter.readable and space == "holding"
            twins = [support.address(index, save=save) for save in (True, False)] if has_twin else []
            for register in (index, *twins):
                by_locator.setdefault((space, register), parameter)
    return by_locator
