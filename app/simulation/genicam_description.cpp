#include "app/simulation/genicam_description.h"

namespace tagdock {

const std::string_view camera_description = R"(<?xml version="1.0" encoding="utf-8"?>
<RegisterDescription ModelName="Simulated" VendorName="tagdock" StandardNameSpace="GEV" SchemaMajorVersion="1"
    SchemaMinorVersion="1" SchemaSubMinorVersion="0" MajorVersion="1" MinorVersion="0" SubMinorVersion="0"
    ToolTip="A camera in the tagdock simulation" ProductGuid="2f1a4c60-5d0e-4b7b-9a53-7b1f3d0c9e11"
    VersionGuid="2f1a4c60-5d0e-4b7b-9a53-7b1f3d0c9e12" xmlns="http://www.genicam.org/GenApi/Version_1_1"
    xmlns:xsi="http://www.w3.org/2001/XMLSchema-instance"
    xsi:schemaLocation="http://www.genicam.org/GenApi/Version_1_1 GenApiSchema_Version_1_1.xsd">
  <Category Name="Root">
    <pFeature>DeviceControl</pFeature><pFeature>ImageFormatControl</pFeature><pFeature>AcquisitionControl</pFeature>
    <pFeature>AnalogControl</pFeature><pFeature>TransportLayerControl</pFeature><pFeature>ChunkDataControl</pFeature>
  </Category>

  <Category Name="DeviceControl">
    <pFeature>DeviceVendorName</pFeature><pFeature>DeviceModelName</pFeature><pFeature>DeviceSerialNumber</pFeature>
    <pFeature>DeviceUserID</pFeature>
  </Category>
  <StringReg Name="DeviceVendorName"><Address>0x48</Address><Length>32</Length><AccessMode>RO</AccessMode><pPort>Device</pPort></StringReg>
  <StringReg Name="DeviceModelName"><Address>0x68</Address><Length>32</Length><AccessMode>RO</AccessMode><pPort>Device</pPort></StringReg>
  <StringReg Name="DeviceSerialNumber"><Address>0xd8</Address><Length>16</Length><AccessMode>RO</AccessMode><pPort>Device</pPort></StringReg>
  <StringReg Name="DeviceUserID"><Address>0xe8</Address><Length>16</Length><AccessMode>RW</AccessMode><pPort>Device</pPort></StringReg>

  <Category Name="ImageFormatControl">
    <pFeature>SensorWidth</pFeature><pFeature>SensorHeight</pFeature><pFeature>WidthMax</pFeature><pFeature>HeightMax</pFeature>
    <pFeature>BinningHorizontal</pFeature><pFeature>BinningVertical</pFeature>
    <pFeature>Width</pFeature><pFeature>Height</pFeature><pFeature>OffsetX</pFeature><pFeature>OffsetY</pFeature>
    <pFeature>PixelFormat</pFeature>
  </Category>
  <Integer Name="SensorWidth"><ImposedAccessMode>RO</ImposedAccessMode><pValue>SensorWidthRegister</pValue></Integer>
  <Integer Name="SensorHeight"><ImposedAccessMode>RO</ImposedAccessMode><pValue>SensorHeightRegister</pValue></Integer>
  <IntSwissKnife Name="WidthMax"><pVariable Name="SENSOR">SensorWidth</pVariable><pVariable Name="BINNING">BinningHorizontal</pVariable><pVariable Name="OFFSET">OffsetX</pVariable><Formula>SENSOR / BINNING - OFFSET</Formula></IntSwissKnife>
  <IntSwissKnife Name="HeightMax"><pVariable Name="SENSOR">SensorHeight</pVariable><pVariable Name="BINNING">BinningVertical</pVariable><pVariable Name="OFFSET">OffsetY</pVariable><Formula>SENSOR / BINNING - OFFSET</Formula></IntSwissKnife>
  <IntSwissKnife Name="OffsetXMax"><pVariable Name="SENSOR">SensorWidth</pVariable><pVariable Name="BINNING">BinningHorizontal</pVariable><pVariable Name="SIZE">Width</pVariable><Formula>SENSOR / BINNING - SIZE</Formula></IntSwissKnife>
  <IntSwissKnife Name="OffsetYMax"><pVariable Name="SENSOR">SensorHeight</pVariable><pVariable Name="BINNING">BinningVertical</pVariable><pVariable Name="SIZE">Height</pVariable><Formula>SENSOR / BINNING - SIZE</Formula></IntSwissKnife>
  <Integer Name="BinningHorizontal"><pValue>BinningHorizontalRegister</pValue><Min>1</Min><Max>4</Max></Integer>
  <Integer Name="BinningVertical"><pValue>BinningVerticalRegister</pValue><Min>1</Min><Max>4</Max></Integer>
  <Integer Name="Width"><pValue>WidthRegister</pValue><Min>16</Min><pMax>WidthMax</pMax><Inc>4</Inc></Integer>
  <Integer Name="Height"><pValue>HeightRegister</pValue><Min>16</Min><pMax>HeightMax</pMax><Inc>2</Inc></Integer>
  <Integer Name="OffsetX"><pValue>OffsetXRegister</pValue><Min>0</Min><pMax>OffsetXMax</pMax><Inc>4</Inc></Integer>
  <Integer Name="OffsetY"><pValue>OffsetYRegister</pValue><Min>0</Min><pMax>OffsetYMax</pMax><Inc>2</Inc></Integer>
  <Enumeration Name="PixelFormat">
    <EnumEntry Name="Mono8"><Value>17301505</Value></EnumEntry>
    <EnumEntry Name="Mono10"><Value>17825795</Value></EnumEntry>
    <EnumEntry Name="Mono10Packed"><Value>17563652</Value></EnumEntry>
    <EnumEntry Name="Mono12"><Value>17825797</Value></EnumEntry>
    <EnumEntry Name="Mono12Packed"><Value>17563654</Value></EnumEntry>
    <EnumEntry Name="Mono16"><Value>17825799</Value></EnumEntry>
    <pValue>PixelFormatRegister</pValue>
  </Enumeration>
  <IntReg Name="SensorWidthRegister"><Address>0xa000</Address><Length>4</Length><AccessMode>RO</AccessMode><pPort>Device</pPort><Sign>Unsigned</Sign><Endianess>BigEndian</Endianess></IntReg>
  <IntReg Name="SensorHeightRegister"><Address>0xa004</Address><Length>4</Length><AccessMode>RO</AccessMode><pPort>Device</pPort><Sign>Unsigned</Sign><Endianess>BigEndian</Endianess></IntReg>
  <IntReg Name="BinningHorizontalRegister"><Address>0xa020</Address><Length>4</Length><AccessMode>RW</AccessMode><pPort>Device</pPort><Sign>Unsigned</Sign><Endianess>BigEndian</Endianess></IntReg>
  <IntReg Name="BinningVerticalRegister"><Address>0xa024</Address><Length>4</Length><AccessMode>RW</AccessMode><pPort>Device</pPort><Sign>Unsigned</Sign><Endianess>BigEndian</Endianess></IntReg>
  <IntReg Name="WidthRegister"><Address>0xa010</Address><Length>4</Length><AccessMode>RW</AccessMode><pPort>Device</pPort><Sign>Unsigned</Sign><Endianess>BigEndian</Endianess></IntReg>
  <IntReg Name="HeightRegister"><Address>0xa014</Address><Length>4</Length><AccessMode>RW</AccessMode><pPort>Device</pPort><Sign>Unsigned</Sign><Endianess>BigEndian</Endianess></IntReg>
  <IntReg Name="OffsetXRegister"><Address>0xa018</Address><Length>4</Length><AccessMode>RW</AccessMode><pPort>Device</pPort><Sign>Unsigned</Sign><Endianess>BigEndian</Endianess></IntReg>
  <IntReg Name="OffsetYRegister"><Address>0xa01c</Address><Length>4</Length><AccessMode>RW</AccessMode><pPort>Device</pPort><Sign>Unsigned</Sign><Endianess>BigEndian</Endianess></IntReg>
  <IntReg Name="PixelFormatRegister"><Address>0xa028</Address><Length>4</Length><AccessMode>RW</AccessMode><pPort>Device</pPort><Sign>Unsigned</Sign><Endianess>BigEndian</Endianess></IntReg>

  <Category Name="AcquisitionControl">
    <pFeature>AcquisitionMode</pFeature><pFeature>AcquisitionStart</pFeature><pFeature>AcquisitionStop</pFeature>
    <pFeature>AcquisitionFrameRate</pFeature><pFeature>ExposureTime</pFeature>
    <pFeature>TriggerSelector</pFeature><pFeature>TriggerMode</pFeature><pFeature>TriggerSource</pFeature><pFeature>TriggerSoftware</pFeature>
  </Category>
  <Enumeration Name="AcquisitionMode"><EnumEntry Name="Continuous"><Value>1</Value></EnumEntry><pValue>AcquisitionModeRegister</pValue></Enumeration>
  <Command Name="AcquisitionStart"><pValue>AcquisitionRegister</pValue><CommandValue>1</CommandValue></Command>
  <Command Name="AcquisitionStop"><pValue>AcquisitionRegister</pValue><CommandValue>0</CommandValue></Command>
  <Float Name="AcquisitionFrameRate"><pValue>FrameRateRegister</pValue><Min>0.5</Min><Max>200.0</Max><Unit>Hz</Unit></Float>
  <Float Name="ExposureTime"><pValue>ExposureRegister</pValue><Min>10.0</Min><Max>1000000.0</Max><Unit>us</Unit></Float>
  <Enumeration Name="TriggerSelector"><EnumEntry Name="FrameStart"><Value>0</Value></EnumEntry><Value>0</Value></Enumeration>
  <Enumeration Name="TriggerMode"><EnumEntry Name="Off"><Value>0</Value></EnumEntry><EnumEntry Name="On"><Value>1</Value></EnumEntry><pValue>TriggerModeRegister</pValue></Enumeration>
  <Enumeration Name="TriggerSource"><EnumEntry Name="Software"><Value>0</Value></EnumEntry><pValue>TriggerSourceRegister</pValue></Enumeration>
  <Command Name="TriggerSoftware"><pValue>TriggerSoftwareRegister</pValue><CommandValue>1</CommandValue></Command>
  <IntReg Name="TriggerModeRegister"><Address>0xa034</Address><Length>4</Length><AccessMode>RW</AccessMode><pPort>Device</pPort><Sign>Unsigned</Sign><Endianess>BigEndian</Endianess></IntReg>
  <IntReg Name="TriggerSourceRegister"><Address>0xa038</Address><Length>4</Length><AccessMode>RW</AccessMode><pPort>Device</pPort><Sign>Unsigned</Sign><Endianess>BigEndian</Endianess></IntReg>
  <IntReg Name="TriggerSoftwareRegister"><Address>0xa03c</Address><Length>4</Length><AccessMode>RW</AccessMode><pPort>Device</pPort><Sign>Unsigned</Sign><Endianess>BigEndian</Endianess></IntReg>
  <IntReg Name="AcquisitionModeRegister"><Address>0xa02c</Address><Length>4</Length><AccessMode>RW</AccessMode><pPort>Device</pPort><Sign>Unsigned</Sign><Endianess>BigEndian</Endianess></IntReg>
  <IntReg Name="AcquisitionRegister"><Address>0xa030</Address><Length>4</Length><AccessMode>RW</AccessMode><pPort>Device</pPort><Sign>Unsigned</Sign><Endianess>BigEndian</Endianess></IntReg>
  <FloatReg Name="ExposureRegister"><Address>0xa040</Address><Length>8</Length><AccessMode>RW</AccessMode><pPort>Device</pPort><Endianess>BigEndian</Endianess></FloatReg>
  <FloatReg Name="GainRegister"><Address>0xa048</Address><Length>8</Length><AccessMode>RW</AccessMode><pPort>Device</pPort><Endianess>BigEndian</Endianess></FloatReg>
  <FloatReg Name="FrameRateRegister"><Address>0xa050</Address><Length>8</Length><AccessMode>RW</AccessMode><pPort>Device</pPort><Endianess>BigEndian</Endianess></FloatReg>

  <Category Name="AnalogControl"><pFeature>Gain</pFeature></Category>
  <Float Name="Gain"><pValue>GainRegister</pValue><Min>0.0</Min><Max>24.0</Max><Unit>dB</Unit></Float>

  <Category Name="TransportLayerControl"><pFeature>PayloadSize</pFeature><pFeature>TLParamsLocked</pFeature><pFeature>PtpEnable</pFeature><pFeature>PtpStatus</pFeature></Category>
  <Boolean Name="PtpEnable"><pValue>PtpEnableRegister</pValue><OnValue>1</OnValue><OffValue>0</OffValue></Boolean>
  <Enumeration Name="PtpStatus"><ImposedAccessMode>RO</ImposedAccessMode><EnumEntry Name="Disabled"><Value>0</Value></EnumEntry><EnumEntry Name="Listening"><Value>1</Value></EnumEntry><pValue>PtpEnableRegister</pValue></Enumeration>
  <IntReg Name="PtpEnableRegister"><Address>0xa058</Address><Length>4</Length><AccessMode>RW</AccessMode><pPort>Device</pPort><Sign>Unsigned</Sign><Endianess>BigEndian</Endianess></IntReg>
  <IntSwissKnife Name="PayloadSize"><pVariable Name="W">Width</pVariable><pVariable Name="H">Height</pVariable><pVariable Name="FORMAT">PixelFormatRegister</pVariable><pVariable Name="CHUNKS">ChunkModeRegister</pVariable><pVariable Name="E">ChunkExposureEnableRegister</pVariable><pVariable Name="G">ChunkGainEnableRegister</pVariable><Formula>W * H * ((FORMAT &gt;&gt; 16) &amp; 0xff) / 8 + CHUNKS * (8 + 16 * E + 16 * G)</Formula></IntSwissKnife>
  <Integer Name="TLParamsLocked"><Value>0</Value><Min>0</Min><Max>1</Max></Integer>

  <Category Name="ChunkDataControl">
    <pFeature>ChunkModeActive</pFeature><pFeature>ChunkSelector</pFeature><pFeature>ChunkEnable</pFeature>
    <pFeature>ChunkExposureTime</pFeature><pFeature>ChunkGain</pFeature>
  </Category>
  <Boolean Name="ChunkModeActive"><pValue>ChunkModeRegister</pValue><OnValue>1</OnValue><OffValue>0</OffValue></Boolean>
  <Enumeration Name="ChunkSelector"><EnumEntry Name="ExposureTime"><Value>0</Value></EnumEntry><EnumEntry Name="Gain"><Value>1</Value></EnumEntry><pValue>ChunkSelectorRegister</pValue></Enumeration>
  <Boolean Name="ChunkEnable"><pValue>ChunkEnableRegister</pValue><OnValue>1</OnValue><OffValue>0</OffValue></Boolean>
  <Float Name="ChunkExposureTime"><pValue>ChunkExposureTimeRegister</pValue><Unit>us</Unit></Float>
  <Float Name="ChunkGain"><pValue>ChunkGainRegister</pValue><Unit>dB</Unit></Float>
  <FloatReg Name="ChunkExposureTimeRegister"><Address>0</Address><Length>8</Length><AccessMode>RO</AccessMode><pPort>ChunkExposureTimePort</pPort><Endianess>BigEndian</Endianess></FloatReg>
  <FloatReg Name="ChunkGainRegister"><Address>0</Address><Length>8</Length><AccessMode>RO</AccessMode><pPort>ChunkGainPort</pPort><Endianess>BigEndian</Endianess></FloatReg>
  <IntReg Name="ChunkModeRegister"><Address>0xa05c</Address><Length>4</Length><AccessMode>RW</AccessMode><pPort>Device</pPort><Sign>Unsigned</Sign><Endianess>BigEndian</Endianess></IntReg>
  <IntReg Name="ChunkSelectorRegister"><Address>0xa060</Address><Length>4</Length><AccessMode>RW</AccessMode><pPort>Device</pPort><Sign>Unsigned</Sign><Endianess>BigEndian</Endianess></IntReg>
  <IntReg Name="ChunkEnableRegister"><Address>0xa064</Address><pIndex Offset="4">ChunkSelectorRegister</pIndex><Length>4</Length><AccessMode>RW</AccessMode><pPort>Device</pPort><Sign>Unsigned</Sign><Endianess>BigEndian</Endianess></IntReg>
  <IntReg Name="ChunkExposureEnableRegister"><Address>0xa064</Address><Length>4</Length><AccessMode>RW</AccessMode><pPort>Device</pPort><Sign>Unsigned</Sign><Endianess>BigEndian</Endianess></IntReg>
  <IntReg Name="ChunkGainEnableRegister"><Address>0xa068</Address><Length>4</Length><AccessMode>RW</AccessMode><pPort>Device</pPort><Sign>Unsigned</Sign><Endianess>BigEndian</Endianess></IntReg>

  <Port Name="Device"/>
  <Port Name="ChunkExposureTimePort"><ChunkID>1001</ChunkID></Port>
  <Port Name="ChunkGainPort"><ChunkID>1002</ChunkID></Port>
</RegisterDescription>
)";

}  // namespace tagdock
